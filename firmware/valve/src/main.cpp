// The board on an RP2040 (Raspberry Pi Pico, Arduino core by Earle Philhower): pins, sensors, clock, watchdog. Everything that
// decides is in lib/valve, which the tests run on a PC.
#include <Arduino.h>
#include <Wire.h>

#include "board.h"

namespace {

// -- what is wired where: change these -----------------------------------------------------------------------------
const uint8_t kInletPins[valve::kChannels] = {2, 4};   // MOSFET of a normally closed valve: high opens it
const uint8_t kOutletPins[valve::kChannels] = {3, 5};  // MOSFET of a normally OPEN valve: high closes it; no power vents
const uint8_t kSdaPin = 8, kSclPin = 9, kAnalogPins[valve::kChannels] = {26, 27};
#ifdef VALVE_I2C_ADDRESS  // an MPRLS-like sensor (Honeywell MPR, 0x18) behind a TCA9548A multiplexer at 0x70, port = channel
const int32_t kSpanPa = 25 * 6895;  // the type's range: 0 to 25 psi absolute, from 10 to 90 % of 2^24 counts
#else                               // an analog sensor, 0.5 V to 4.5 V over a 2:3 divider, such as MPX5010GP-like types
const int32_t kZeroMv = 200, kSpanMv = 4500, kSpanPa = 10000;  // data sheet: Vout = 5 V (0.09 p/kPa + 0.04)
#endif
const uint32_t kPeriodUs = 5000, kSliceUs = 20000, kWatchdogMs = 100;

void send(const char* data, size_t size, void*) {
  if (Serial.availableForWrite() >= static_cast<int>(size)) Serial.write(data, size);  // a host that never reads stops nothing
}

valve::Board board(send, nullptr);
valve::Sample samples[valve::kChannels];
valve::Output outputs[valve::kChannels];
int32_t zero_pa[valve::kChannels];

#ifdef VALVE_I2C_ADDRESS
bool read_absolute(int channel, int32_t* pa) {
  Wire.beginTransmission(0x70);
  Wire.write(1 << channel);
  if (Wire.endTransmission() != 0) return false;
  const bool came = Wire.requestFrom(VALVE_I2C_ADDRESS, 4) == 4;
  const uint8_t status = came ? Wire.read() : 0xFF;
  uint32_t counts = 0;
  for (int i = 0; came && i < 3; ++i) counts = counts << 8 | static_cast<uint32_t>(Wire.read());
  Wire.beginTransmission(VALVE_I2C_ADDRESS);  // the next measurement, ready in 5 ms
  Wire.write(0xAA);
  Wire.write(0);
  Wire.write(0);
  const bool asked = Wire.endTransmission() == 0;
  if (!came || !asked || (status & 0x25) != 0 || !(status & 0x40)) return false;  // busy, memory error, saturated, no power
  *pa = static_cast<int32_t>((static_cast<int64_t>(counts) - 1677722) * kSpanPa / 13421773);
  return true;
}
#else
bool read_absolute(int channel, int32_t* pa) {
  const int32_t mv = analogRead(kAnalogPins[channel]) * 3300L / 4095 * 3 / 2;
  *pa = (mv - kZeroMv) * kSpanPa / kSpanMv;
  return mv > 50 && mv < 4900;  // a broken or shorted wire
}
#endif

void sample_all() {
  for (int i = 0; i < valve::kChannels; ++i) {
    int32_t pa = 0;
    samples[i].valid = read_absolute(i, &pa);
    samples[i].pa = pa - zero_pa[i];
  }
}

// On-off valves get their share as time: `share` of 255 of each slice.
void drive(uint32_t now_us) {
  const uint32_t phase = now_us % kSliceUs * 255 / kSliceUs;
  for (int i = 0; i < valve::kChannels; ++i) {
    digitalWrite(kInletPins[i], outputs[i].inlet > phase);
    digitalWrite(kOutletPins[i], !(outputs[i].outlet > phase));
  }
}

}  // namespace

void setup() {
  for (int i = 0; i < valve::kChannels; ++i) {
    pinMode(kInletPins[i], OUTPUT);
    pinMode(kOutletPins[i], OUTPUT);
    digitalWrite(kInletPins[i], LOW);
    digitalWrite(kOutletPins[i], LOW);  // vented
  }
  Serial.begin(115200);
  Wire.setSDA(kSdaPin);
  Wire.setSCL(kSclPin);
  Wire.begin();
  analogReadResolution(12);
  delay(500);  // what was in the chambers is out: this is zero
  int64_t sums[valve::kChannels] = {};
  int counts[valve::kChannels] = {};
  for (int k = 0; k < 40; ++k, delay(6)) {
    sample_all();
    for (int i = 0; i < valve::kChannels; ++i)
      if (samples[i].valid) sums[i] += samples[i].pa, ++counts[i];
  }
  for (int i = 0; i < valve::kChannels; ++i) zero_pa[i] = counts[i] ? static_cast<int32_t>(sums[i] / counts[i]) : 0;
  rp2040.wdt_begin(kWatchdogMs);  // a loop that hangs resets the board, whose pins then vent
}

void loop() {
  static uint32_t next_us = micros();
  rp2040.wdt_reset();
  while (Serial.available()) board.receive(static_cast<uint8_t>(Serial.read()), millis());
  if (static_cast<int32_t>(micros() - next_us) >= 0) {
    next_us += kPeriodUs;
    sample_all();
    board.tick(millis(), samples, outputs);
  }
  drive(micros());
}
