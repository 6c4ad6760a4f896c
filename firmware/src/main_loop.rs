//! Bytes in, one control step every 5 ms, bytes out.

use embedded_io::{Read, ReadReady, Write, WriteReady};
use heapless::Deque;
use vine_arm::Device;

use crate::board::Board;

/// Control period, µs.
pub const PERIOD_US: u32 = 5_000;

/// Frames on their way to the host. A frame that does not fit is dropped whole: the line is slower than the answers,
/// and the host misses an acknowledgement.
type Outbox = Deque<u8, 512>;

fn post(outbox: &mut Outbox, frame: &[u8]) {
    if outbox.capacity() - outbox.len() >= frame.len() {
        // There is room.
        outbox.extend(frame.iter().copied());
    }
}

/// Runs the arm for ever. No part of the loop waits but its sleep, and bytes are taken a few at a time, so that neither a silent nor
/// a shouting host delays a control step.
pub fn run(mut board: impl Board, mut device: Device) -> ! {
    let mut outbox = Outbox::new();
    let mut last_us = board.now_us();
    loop {
        let serial = board.serial();
        if serial.read_ready().unwrap_or(false) {
            let mut bytes = [0; 32];
            let count = serial.read(&mut bytes).unwrap_or(0);
            device.receive(&bytes[..count], |frame| post(&mut outbox, frame));
        }
        if serial.write_ready().unwrap_or(false)
            && let Some(byte) = outbox.pop_front()
        {
            let _ = serial.write(&[byte]);
        }
        let elapsed_us = board.now_us().wrapping_sub(last_us);
        if elapsed_us >= PERIOD_US {
            last_us = last_us.wrapping_add(elapsed_us);
            let sensors = board.sensors();
            board.apply(device.step(elapsed_us, sensors, |frame| post(&mut outbox, frame)));
            board.feed_watchdog();
        } else if outbox.is_empty() {
            board.sleep();
        }
    }
}
