//! What the main loop needs of a board.

use embedded_io::{Read, ReadReady, Write, WriteReady};
use vine_arm::{Actuators, Sensors};

/// A board with one arm on it.
pub trait Board {
    /// The line to the host.
    type Serial: Read + ReadReady + Write + WriteReady;

    /// The line to the host.
    fn serial(&mut self) -> &mut Self::Serial;

    /// Free-running time, µs, wrapping.
    fn now_us(&mut self) -> u32;

    /// Reads the sensors.
    fn sensors(&mut self) -> Sensors;

    /// Drives motor and pumps.
    fn apply(&mut self, actuators: Actuators);

    /// Sleeps until a byte has arrived or a control period is over, whichever comes first.
    fn sleep(&mut self);

    /// Tells the hardware watchdog that the main loop runs; without this for a quarter of a second the board resets.
    fn feed_watchdog(&mut self);
}
