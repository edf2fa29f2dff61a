//! The motion board's logic with time and pins as arguments, so that the same code runs on the
//! RP2040, in the simulated MCU on the host, and in tests.
#![no_std]
