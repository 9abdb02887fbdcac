// The board on a PC: the same state machine behind a pty, with simulated chambers. For tests.
//
//   valve_host            prints the pty's path, then obeys lines on stdin: "sensor N ON", "leak N ON", "stuck ON", "push N PA",
//                         "over N ON" (the inlet does not close), "hang ON", "reset", "ask"; it ends with its stdin
//   valve_host fuzz N S   damages lines, N bytes of seed S, and prints how many lines were accepted
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "board.h"

using valve::kChannels;

namespace {

struct Chamber {
  double pa = 0.0;
  bool sensor_failed = false, leaks = false, over = false;
  double push = 0.0;  // Pa that an object adds
};

Chamber chambers[kChannels];
bool stuck = false, hangs = false;
int master = -1;

// MJTACTILE_SLOW=3: a third of the speed, as the host on the other side of the pty.
uint32_t now_ms() {
  static const char* const told = getenv("MJTACTILE_SLOW");
  static const double slow = told ? atof(told) : 1.0;
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return static_cast<uint32_t>(static_cast<uint64_t>((1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec)) / slow));
}

void send_pty(const char* data, size_t size, void*) {
  if (write(master, data, size) < 0) return;  // nobody reads: lost
}

valve::Output outputs[kChannels];

// First-order flow through each valve: from a supply of 10 kPa in 0.5 s, to the air in 0.1 s when fully open.
void flow(double seconds) {
  for (int i = 0; i < kChannels; ++i) {
    Chamber& c = chambers[i];
    if (stuck) continue;
    const double inlet = c.over ? 1.0 : outputs[i].inlet / 255.0;
    c.pa += seconds * (inlet * (10000.0 - c.pa) / 0.5 - outputs[i].outlet / 255.0 * c.pa / 0.1);
    if (c.leaks) c.pa -= seconds * c.pa / 0.3;
  }
}

void command(const char* line, valve::Board& board) {
  char word[16] = "";
  int n = 0;
  double value = 0;
  sscanf(line, "%15s %d %lf", word, &n, &value);
  Chamber& c = chambers[n >= 1 && n <= kChannels ? n - 1 : 0];
  if (!strcmp(word, "sensor")) c.sensor_failed = value != 0;
  if (!strcmp(word, "leak")) c.leaks = value != 0;
  if (!strcmp(word, "over")) c.over = value != 0;
  if (!strcmp(word, "push")) c.push = value;
  if (!strcmp(word, "stuck")) stuck = n != 0;
  if (!strcmp(word, "hang")) hangs = n != 0;
  if (!strcmp(word, "reset")) {  // what the hardware watchdog does
    board = valve::Board(send_pty, nullptr);
    for (valve::Output& out : outputs) out = valve::Output();
  }
  printf("{");
  for (int i = 0; i < kChannels; ++i)
    printf("\"pa_%d\": %.3f, \"state_%d\": %d, \"fault_%d\": %d, ", i + 1, chambers[i].pa, i + 1,
           static_cast<int>(board.channel(i).state), i + 1, static_cast<int>(board.channel(i).fault));
  printf("\"damaged\": %lu, \"accepted\": %lu}\n", static_cast<unsigned long>(board.damaged()),
         static_cast<unsigned long>(board.accepted()));
  fflush(stdout);
}

void step(valve::Board& board) {
  valve::Sample samples[kChannels];
  for (int i = 0; i < kChannels; ++i) {
    samples[i].valid = !chambers[i].sensor_failed;
    samples[i].pa = static_cast<int32_t>(chambers[i].pa + (outputs[i].outlet ? 0.0 : chambers[i].push));
  }
  board.tick(now_ms(), samples, outputs);
}

int serve() {
  master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (master < 0 || grantpt(master) || unlockpt(master)) return 1;
  const char* path = ptsname(master);
  const int slave = open(path, O_RDWR | O_NOCTTY);  // kept, so that a host may come and go
  termios raw;
  tcgetattr(slave, &raw);
  cfmakeraw(&raw);
  tcsetattr(slave, TCSANOW, &raw);
  printf("%s\n", path);
  fflush(stdout);
  valve::Board board(send_pty, nullptr);
  char line[128];
  for (uint32_t last = now_ms();;) {
    pollfd waits[2] = {{0, POLLIN, 0}, {master, POLLIN, 0}};
    poll(waits, 2, 2);
    if (waits[0].revents & (POLLIN | POLLHUP)) {
      size_t size = 0;
      char c = 0;
      while (size < sizeof line - 1 && read(0, &c, 1) == 1 && c != '\n') line[size++] = c;
      if (c != '\n') return 0;
      line[size] = 0;
      command(line, board);
    }
    char bytes[256];
    const ssize_t count = read(master, bytes, sizeof bytes);
    for (ssize_t i = 0; !hangs && i < count; ++i) board.receive(static_cast<uint8_t>(bytes[i]), now_ms());
    const uint32_t now = now_ms();
    if (now - last >= 2) {
      flow((now - last) * 1e-3);
      last = now;
      if (!hangs) step(board);
    }
  }
}

uint64_t seed = 1;
uint32_t draw(uint32_t below) {  // xorshift64*
  seed ^= seed >> 12;
  seed ^= seed << 25;
  seed ^= seed >> 27;
  return static_cast<uint32_t>((seed * 2685821657736338717ull) >> 33) % below;
}

void drop(const char*, size_t, void*) {}

// Lines as a noisy wire leaves them: bits turned, bytes lost, doubled, put in, cut off, and plain noise.
int fuzz(unsigned long bytes) {
  valve::Board board(drop, nullptr);
  const char* const bodies[] = {"17 set 1 1000", "4 vent 2", "65535 beat 250", "9 seal 1", "3 limit 2 6000", "8 id", "12 state 1"};
  unsigned long fed = 0, lines = 0;
  while (fed < bytes) {
    char line[300], whole[300];
    const size_t size = valve::frame(bodies[draw(7)], whole);
    size_t n = 0;
    const uint32_t kind = draw(8);
    if (kind == 7) {
      n = 1 + draw(100);
      for (size_t i = 0; i < n; ++i) line[i] = static_cast<char>(draw(256));
      line[n++] = '\n';
    } else {
      memcpy(line, whole, n = size);
      for (uint32_t k = 1 + draw(3); k; --k) {
        const size_t at = draw(static_cast<uint32_t>(n));
        const uint32_t how = draw(4);
        if (how == 0) line[at] = static_cast<char>(line[at] ^ (1 << draw(8)));
        if (how == 1) memmove(line + at, line + at + 1, --n - at);
        if (how == 2) memmove(line + at + 1, line + at, n++ - at), line[at] = static_cast<char>(draw(256));
        if (how == 3) memmove(line + at + 4, line + at, n - at), n += 4;
        if (n == 0) line[n++] = '\n';
      }
    }
    // A line that came through whole, whatever stands around it, is no damaged one.
    if (memmem(line, n, whole, size - 1)) continue;
    if (line[n - 1] != '\n') line[n++] = '\n';
    for (size_t i = 0; i < n; ++i) board.receive(static_cast<uint8_t>(line[i]), 0);
    fed += n;
    ++lines;
  }
  printf("{\"bytes\": %lu, \"lines\": %lu, \"accepted\": %lu}\n", fed, lines, static_cast<unsigned long>(board.accepted()));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 4 && !strcmp(argv[1], "fuzz")) {
    seed = strtoull(argv[3], nullptr, 10) * 2 + 1;
    return fuzz(strtoul(argv[2], nullptr, 10));
  }
  return serve();
}
