// Lines of "mjvalve": SEQUENCE WORD ARGUMENTS*CRC, an end of line. See ../../README.md.
#pragma once
#include <stddef.h>
#include <stdint.h>

namespace valve {

constexpr size_t kLongest = 80;  // bytes of a line without its end

// CRC-32 of IEEE 802.3 (reflected 0xEDB88320, start and final complement), as zlib's and Ethernet's.
uint32_t crc32(const char* data, size_t size);

// Collects bytes to lines. `feed` returns true when a line is complete and undamaged; `body` is then the line without its CRC.
class Receiver {
 public:
  bool feed(uint8_t byte);
  const char* body() const { return line_; }
  uint32_t damaged() const { return damaged_; }  // lines that were thrown away

 private:
  bool finish();

  char line_[kLongest + 1];
  size_t size_ = 0;
  bool bad_ = false;
  uint32_t damaged_ = 0;
};

// Writes "BODY*CRC\n" into `out` of at least kLongest + 2 bytes; returns its size, 0 when it is too long.
size_t frame(const char* body, char* out);

}  // namespace valve
