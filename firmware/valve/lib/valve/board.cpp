#include "board.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

namespace valve {

static const char* const kStates[] = {"vent", "set", "sealed"};
static const char* const kFaults[] = {"ok", "start", "silent", "sensor", "pressure"};
static const int kNumbersMax = 2;

// A whole decimal number and nothing else.
static bool read_number(const char* text, int32_t* out) {
  if (*text < '0' || *text > '9' || strlen(text) > 6) return false;
  char* end = nullptr;
  long value = strtol(text, &end, 10);
  *out = static_cast<int32_t>(value);
  return *end == 0;
}

void Board::receive(uint8_t byte, uint32_t now) {
  if (!receiver_.feed(byte)) return;
  char body[kLongest + 1];
  strncpy(body, receiver_.body(), sizeof body - 1);
  body[sizeof body - 1] = 0;
  obey(body, now);
}

void Board::obey(char* body, uint32_t now) {
  char* parts[2 + kNumbersMax] = {};
  int count = 0;
  for (char* part = strtok(body, " "); part; part = strtok(nullptr, " ")) {
    if (count < 2 + kNumbersMax) parts[count] = part;
    ++count;
  }
  int32_t sequence = 0, numbers[kNumbersMax] = {};
  if (count < 2 || !read_number(parts[0], &sequence)) return;
  heard_ = now;
  ++accepted_;
  if (count > 2 + kNumbersMax) return answer(parts[0], "error unknown");
  for (int i = 2; i < count; ++i)
    if (!read_number(parts[i], &numbers[i - 2])) return answer(parts[0], "error number");
  answer(parts[0], command(parts[1], numbers, count - 2));
}

// Carry out one command; returns the text of its answer: the command again, or an error.
const char* Board::command(const char* word, const int32_t* numbers, int count) {
  if (!strcmp(word, "id") && count == 0) {
    snprintf(text_, sizeof text_, "id mjvalve 1.1 %d %d %ld", kChannels, kSensors, static_cast<long>(kMaxPa));
    return text_;
  }
  if (!strcmp(word, "beat") && count == 1) {
    if (numbers[0] < static_cast<int32_t>(kBeatMin) || numbers[0] > static_cast<int32_t>(kBeatMax)) return "error range";
    beat_ = static_cast<uint32_t>(numbers[0]);
    snprintf(text_, sizeof text_, "beat %ld", static_cast<long>(numbers[0]));
    return text_;
  }
  if (!strcmp(word, "hold") && count == 1) {
    if (numbers[0] > static_cast<int32_t>(kHoldMax)) return "error range";
    hold_ = static_cast<uint32_t>(numbers[0]);
    snprintf(text_, sizeof text_, "hold %ld", static_cast<long>(numbers[0]));
    return text_;
  }
  if (count < 1) return "error unknown";
  if (numbers[0] < 1 || numbers[0] > kChannels) return "error channel";
  return command_channel(word, channels_[numbers[0] - 1], numbers, count);
}

const char* Board::command_channel(const char* word, Channel& channel, const int32_t* numbers, int count) {
  const bool is_set = !strcmp(word, "set") && count == 2, is_limit = !strcmp(word, "limit") && count == 2;
  const bool is_seal = !strcmp(word, "seal") && count == 1, is_vent = !strcmp(word, "vent") && count == 1;
  if (!strcmp(word, "state") && count == 1) {
    char pressure[12] = "-";
    if (channel.sample.valid) snprintf(pressure, sizeof pressure, "%ld", static_cast<long>(channel.sample.pa));
    snprintf(text_, sizeof text_, "state %ld %s %s %s", static_cast<long>(numbers[0]), kStates[static_cast<int>(channel.state)],
             pressure, kFaults[static_cast<int>(channel.fault)]);
    return text_;
  }
  if (is_vent) {  // always obeyed, and says that the host knows of the fault
    trip(channel, Fault::kNone);
    channel.sensor_strikes = channel.pressure_strikes = 0;
  } else if (is_limit) {
    if (numbers[1] < 1 || numbers[1] > kMaxPa) return "error limit";
    channel.limit = numbers[1];
  } else if (is_set || is_seal) {
    if (beat_ == 0) return "error beat";  // nothing is inflated for a host that nobody watches
    if (channel.fault != Fault::kNone) return "error fault";
    if (is_set && numbers[1] > channel.limit) return "error limit";
    channel.state = is_set ? State::kSet : State::kSealed;
    if (is_set) channel.goal = numbers[1];
  } else {
    return "error unknown";
  }
  const long first = numbers[0], second = numbers[1];
  if (count == 2) snprintf(text_, sizeof text_, "%s %ld %ld", word, first, second);
  else snprintf(text_, sizeof text_, "%s %ld", word, first);
  return text_;
}

void Board::answer(const char* sequence, const char* text) {
  char body[kLongest + 1], line[kLongest + 2];
  snprintf(body, sizeof body, "%s %s", sequence, text);
  size_t size = frame(body, line);
  if (size) send_(line, size, context_);
}

void Board::tick(uint32_t now, const Sample (&samples)[kChannels], Output (&outputs)[kChannels]) {
  const uint32_t quiet = now - heard_;
  const bool silent = beat_ != 0 && quiet > beat_;  // stays armed: whoever speaks again is watched again
  const bool lost = silent && quiet - beat_ > hold_;
  for (int i = 0; i < kChannels; ++i) {
    Channel& channel = channels_[i];
    if (lost && channel.state != State::kVent) {
      trip(channel, Fault::kSilent);
      channel.slow = hold_ != 0;
      channel.since = now;
    } else if (silent && channel.state == State::kSet) {
      channel.state = State::kSealed;  // a host that is only late finds what it left
    }
    if (channel.slow && now - channel.since > kSlowTime) channel.slow = false;
    look(channel, samples[i]);
    outputs[i] = control(channel);
  }
}

// Vent, and take no new pressure until the host has vented too.
void Board::trip(Channel& channel, Fault fault) {
  channel.state = State::kVent;
  channel.goal = 0;
  channel.slow = false;
  channel.fault = fault;
}

void Board::look(Channel& channel, const Sample& sample) {
  channel.sample = sample;
  if (!kSensors) {
    channel.sample.valid = false;
    return;
  }
  const bool believable = sample.valid && sample.pa > -2 * kMaxPa && sample.pa < 4 * kMaxPa;
  channel.sample.valid = believable;
  channel.sensor_strikes = believable ? 0 : channel.sensor_strikes + 1;
  const bool high = believable && channel.state != State::kVent && sample.pa > channel.limit + channel.limit / 4 + 200;
  channel.pressure_strikes = high ? channel.pressure_strikes + 1 : 0;
  if (channel.sensor_strikes >= kStrikes) trip(channel, Fault::kSensor);
  else if (channel.pressure_strikes >= kStrikes) trip(channel, Fault::kPressure);
}

// Which way the valves stand: in proportion to what is missing, fully open from 500 Pa on; nothing within 10 Pa.
Output Board::control(const Channel& channel) {
  Output out;
  if (channel.state == State::kVent) {
    if (channel.slow) out.outlet = kSlowShare;
    return out;
  }
  out.outlet = 0;
  if (channel.state == State::kSealed) return out;
  if (!kSensors) {
    out.inlet = 255;
    return out;
  }
  if (!channel.sample.valid) return out;  // until it is a fault
  const int32_t missing = channel.goal - channel.sample.pa;
  const int32_t size = missing < 0 ? -missing : missing;
  const uint8_t share = size <= 10 ? 0 : size >= 500 ? 255 : static_cast<uint8_t>(20 + size * 235 / 500);
  (missing > 0 ? out.inlet : out.outlet) = share;
  return out;
}

}  // namespace valve
