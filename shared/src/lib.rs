//! What the motion board and the host must agree on: units, messages, framing, the trigger plan
//! and error codes. `no_std`, no allocation; knows neither the firmware nor the host.
#![no_std]
