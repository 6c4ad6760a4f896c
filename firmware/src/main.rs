//! Firmware of the arm's microcontroller: start-up and panics. The [`main_loop`] is the same for every board.

#![no_std]
#![no_main]

mod board;
mod drivers;
mod main_loop;
mod microbit;

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use vine_arm::{Device, Limits};

#[entry]
fn main() -> ! {
    let device = Device::new(Limits::default()).expect("the prototype's limits are possible");
    main_loop::run(microbit::Microbit::take(), device)
}

/// Resets: every output falls back to its safe level, and the arm waits for a set-point.
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    SCB::sys_reset()
}
