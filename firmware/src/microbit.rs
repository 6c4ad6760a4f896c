//! The micro:bit (nRF51822), as qemu emulates it.
//!
//! UART, timer and pins are the microcontroller's; motor and pumps are driven through them like on any board. What hangs
//! on them is simulated: there is no spool and no tube, so the pins are read back and act on a [`Plant`], and the sensors
//! read that. The nRF51 has no PWM unit either; the motor's enable input is a number in memory.

mod serial;
mod tick;

use core::convert::Infallible;

use embedded_hal::digital::StatefulOutputPin;
use embedded_hal::pwm::{ErrorType, SetDutyCycle};
use nrf51_hal::gpio::{Disconnected, Level, Output, Pin, PushPull, p0};
use nrf51_hal::pac::{Peripherals, TIMER0, WDT};
use nrf51_hal::timer::{Periodic, Timer};
use nrf51_hal::uart::{Baudrate, Parity, Pins, Uart};
use nrf51_hal::wdt::handles::Hdl0;
use nrf51_hal::wdt::{Watchdog, WatchdogHandle, count};
use serial::Serial;
use vine_arm::plant::{Plant, PlantParameters};
use vine_arm::{Actuators, Air, Sensors};

use crate::board::Board;
use crate::drivers::{AirSwitch, Motor};

/// Length of the simulated arm at power-up, m.
const START_LENGTH_M: f32 = 0.7;
/// A quarter of a second of the watchdog's 32.768 kHz.
const WATCHDOG_TICKS: u32 = 8192;

type OutputPin = Pin<Output<PushPull>>;

/// The board.
pub struct Microbit {
    serial: Serial,
    timer: Timer<TIMER0, Periodic>,
    motor: Motor<SimulatedPwm, OutputPin>,
    air: AirSwitch<OutputPin>,
    watchdog: Option<WatchdogHandle<Hdl0>>,
    plant: Plant,
    plant_us: u32,
}

impl Microbit {
    /// Takes the peripherals; once.
    pub fn take() -> Microbit {
        let peripherals = Peripherals::take().expect("taken once, by main");
        let pins = p0::Parts::new(peripherals.GPIO);

        // A free-running microsecond clock.
        let mut timer = Timer::periodic(peripherals.TIMER0);
        timer.start(u32::MAX);
        tick::start(peripherals.TIMER1);

        // Enabled first: qemu ignores every other register of a disabled UART. Started too: the HAL begins with a byte
        // that makes the UART say "ready to send", and qemu drops it before the start.
        peripherals.UART0.enable.write(|w| w.enable().enabled());
        // SAFETY: a task register takes any number, and starting to send touches no memory.
        #[allow(unsafe_code)]
        peripherals.UART0.tasks_starttx.write(|w| unsafe { w.bits(1) });
        // The interrupt is for received bytes alone: sending polls.
        peripherals.UART0.intenset.write(|w| w.rxdrdy().set());
        let uart_pins = Pins {
            txd: pins.p0_24.into_push_pull_output(Level::High).degrade(),
            rxd: pins.p0_25.into_floating_input().degrade(),
            cts: None,
            rts: None,
        };
        let uart = Uart::new(
            peripherals.UART0,
            uart_pins,
            Parity::EXCLUDED,
            Baudrate::BAUD115200,
        );

        // On the edge connector: 0, 1, 2 for the motor's bridge and the pumps, 8 for a vent.
        let output = |pin: Pin<Disconnected>| pin.into_push_pull_output(Level::Low);
        let motor = Motor {
            enable: SimulatedPwm { duty: 0 },
            forward: output(pins.p0_03.degrade()),
            backward: output(pins.p0_02.degrade()),
        };
        let air = AirSwitch {
            pumps: output(pins.p0_01.degrade()),
            vent: output(pins.p0_18.degrade()),
        };

        Microbit {
            serial: Serial::start(uart),
            timer,
            motor,
            air,
            watchdog: start_watchdog(peripherals.WDT),
            plant: Plant::at(PlantParameters::default(), START_LENGTH_M),
            plant_us: 0,
        }
    }

    /// What the pins say, as the bridge would understand them.
    fn driven(&mut self) -> Actuators {
        let duty = f32::from(self.motor.enable.duty) / f32::from(SimulatedPwm::FULL);
        let is_high = |pin: &mut OutputPin| pin.is_set_high().unwrap_or(false);
        Actuators {
            growth_duty: match (
                is_high(&mut self.motor.forward),
                is_high(&mut self.motor.backward),
            ) {
                (true, false) => duty,
                (false, true) => -duty,
                _ => 0.0,
            },
            air: match (is_high(&mut self.air.pumps), is_high(&mut self.air.vent)) {
                (true, _) => Air::Inflate,
                (false, true) => Air::Vent,
                (false, false) => Air::Off,
            },
        }
    }
}

/// Starts the hardware watchdog, or takes it over if it outlived a reset.
fn start_watchdog(peripheral: WDT) -> Option<WatchdogHandle<Hdl0>> {
    let parts = match Watchdog::try_new(peripheral) {
        Ok(mut watchdog) => {
            watchdog.set_lfosc_ticks(WATCHDOG_TICKS);
            watchdog.activate::<count::One>()
        }
        Err(running) => Watchdog::try_recover::<count::One>(running).ok()?,
    };
    Some(parts.handles.0)
}

impl Board for Microbit {
    type Serial = Serial;

    fn serial(&mut self) -> &mut Serial {
        &mut self.serial
    }

    fn now_us(&mut self) -> u32 {
        self.timer.read()
    }

    fn sensors(&mut self) -> Sensors {
        let now_us = self.now_us();
        let elapsed_us = now_us.wrapping_sub(self.plant_us);
        self.plant_us = now_us;
        let actuators = self.driven();
        self.plant.step(elapsed_us as f32 * 1e-6, actuators);
        self.plant.sensors()
    }

    fn apply(&mut self, actuators: Actuators) {
        self.motor.drive(actuators.growth_duty);
        self.air.set(actuators.air);
    }

    fn sleep(&mut self) {
        self.serial.sleep_if_empty();
    }

    fn feed_watchdog(&mut self) {
        if let Some(watchdog) = &mut self.watchdog {
            watchdog.pet();
        }
    }
}

/// The motor's enable input.
struct SimulatedPwm {
    duty: u16,
}

impl SimulatedPwm {
    const FULL: u16 = 1000;
}

impl ErrorType for SimulatedPwm {
    type Error = Infallible;
}

impl SetDutyCycle for SimulatedPwm {
    fn max_duty_cycle(&self) -> u16 {
        Self::FULL
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.duty = duty;
        Ok(())
    }
}
