// The valve board's state machine: what a host may ask for, and when the board vents by itself. No hardware in here.
#pragma once
#include <stddef.h>
#include <stdint.h>

#include "protocol.h"

namespace valve {

#ifndef VALVE_CHANNELS
#define VALVE_CHANNELS 2
#endif
#ifndef VALVE_MAX_PA  // what the build never exceeds, whatever a host says
#define VALVE_MAX_PA 6000
#endif
#ifndef VALVE_SENSORS  // 0: relays without a pressure sensor, on a supply that cannot burst a membrane
#define VALVE_SENSORS 1
#endif

constexpr int kChannels = VALVE_CHANNELS;
constexpr int32_t kMaxPa = VALVE_MAX_PA;
constexpr bool kSensors = VALVE_SENSORS;
constexpr uint32_t kBeatMin = 20, kBeatMax = 60000;  // ms
constexpr uint32_t kHoldMax = 600000;                // ms
constexpr uint32_t kSlowTime = 10000;                // ms of venting through an outlet that is
constexpr uint8_t kSlowShare = 13;                   // open by a twentieth, what was held for a host
constexpr uint32_t kStrikes = 3;                     // samples in a row that make a fault

enum class State : uint8_t { kVent, kSet, kSealed };
enum class Fault : uint8_t { kNone, kStart, kSilent, kSensor, kPressure };

struct Sample {     // one channel's sensor
  bool valid = false;
  int32_t pa = 0;   // gauge
};

struct Output {      // one channel's two valves, 0 to 255: share of the time, or of a proportional valve's way
  uint8_t inlet = 0;
  uint8_t outlet = 255;
};

struct Channel {
  State state = State::kVent;
  Fault fault = Fault::kStart;
  int32_t goal = 0, limit = 0;  // Pa
  bool slow = false;            // it vents slowly, since `since` ms
  uint32_t since = 0;
  Sample sample;
  uint32_t sensor_strikes = 0, pressure_strikes = 0;
};

class Board {
 public:
  using Send = void (*)(const char* data, size_t size, void* context);

  Board(Send send, void* context) : send_(send), context_(context) {}

  // A byte from the host, at `now` ms of a clock that may wrap around.
  void receive(uint8_t byte, uint32_t now);
  // Look at the sensors and the clock, and say how the valves shall stand; at least every 10 ms.
  void tick(uint32_t now, const Sample (&samples)[kChannels], Output (&outputs)[kChannels]);

  const Channel& channel(int i) const { return channels_[i]; }
  uint32_t damaged() const { return receiver_.damaged(); }
  uint32_t accepted() const { return accepted_; }

 private:
  void obey(char* body, uint32_t now);
  const char* command(const char* word, const int32_t* numbers, int count);
  const char* command_channel(const char* word, Channel& channel, const int32_t* numbers, int count);
  void answer(const char* sequence, const char* text);
  static void trip(Channel& channel, Fault fault);
  static void look(Channel& channel, const Sample& sample);
  static Output control(const Channel& channel);

  Send send_;
  void* context_;
  Receiver receiver_;
  Channel channels_[kChannels];
  uint32_t beat_ = 0, hold_ = 0, heard_ = 0, accepted_ = 0;
  char text_[kLongest];
};

}  // namespace valve
