#include "protocol.h"

#include <stdio.h>
#include <string.h>

namespace valve {

uint32_t crc32(const char* data, size_t size) {
  uint32_t crc = 0xFFFFFFFFu;
  for (size_t i = 0; i < size; ++i) {
    crc ^= static_cast<uint8_t>(data[i]);
    for (int bit = 0; bit < 8; ++bit) crc = crc & 1 ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
  }
  return ~crc;
}

static int hex_digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

bool Receiver::feed(uint8_t byte) {
  if (byte == '\n') {
    bool good = finish();
    size_ = 0;
    bad_ = false;
    return good;
  }
  if (byte < 0x20 || byte > 0x7E || size_ == kLongest) bad_ = true;  // until the line ends
  if (!bad_) line_[size_++] = static_cast<char>(byte);
  return false;
}

bool Receiver::finish() {
  if (size_ == 0 && !bad_) return false;  // an empty line is nothing
  bool good = !bad_ && size_ > 9 && line_[size_ - 9] == '*';
  uint32_t said = 0;
  for (size_t i = size_ - 8; good && i < size_; ++i) {
    int digit = hex_digit(line_[i]);
    good = digit >= 0;
    said = said << 4 | static_cast<uint32_t>(digit & 15);
  }
  good = good && crc32(line_, size_ - 9) == said;
  if (good) line_[size_ - 9] = 0;
  else ++damaged_;
  return good;
}

size_t frame(const char* body, char* out) {
  size_t size = strlen(body);
  if (size + 9 > kLongest) return 0;
  return static_cast<size_t>(snprintf(out, kLongest + 2, "%s*%08lX\n", body, static_cast<unsigned long>(crc32(body, size))));
}

}  // namespace valve
