//! Motor and pumps behind embedded-hal's traits. Pins that cannot be set are the board's affair: on
//! microcontrollers setting a pin does not fail.

use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use vine_arm::Air;

/// A DC motor on one channel of an H-bridge: two direction inputs and an enable input with PWM.
pub struct Motor<Enable, Pin> {
    pub enable: Enable,
    pub forward: Pin,
    pub backward: Pin,
}

impl<Enable: SetDutyCycle, Pin: OutputPin> Motor<Enable, Pin> {
    /// Turns at `duty`, −1 to 1; at zero both inputs are low and the motor coasts against its gear.
    pub fn drive(&mut self, duty: f32) {
        // Both low in between: never both high, and never the old duty in the new direction.
        let _ = self.forward.set_low();
        let _ = self.backward.set_low();
        let full = f32::from(self.enable.max_duty_cycle());
        let magnitude = if duty < 0.0 { -duty } else { duty };
        let _ = self.enable.set_duty_cycle((magnitude * full) as u16);
        if duty > 0.0 {
            let _ = self.forward.set_high();
        } else if duty < 0.0 {
            let _ = self.backward.set_high();
        }
    }
}

/// Pumps and vent, one switched output each.
pub struct AirSwitch<Pin> {
    pub pumps: Pin,
    pub vent: Pin,
}

impl<Pin: OutputPin> AirSwitch<Pin> {
    /// Switches to `air`, always off before on.
    pub fn set(&mut self, air: Air) {
        if air != Air::Inflate {
            let _ = self.pumps.set_low();
        }
        if air != Air::Vent {
            let _ = self.vent.set_low();
        }
        match air {
            Air::Off => {}
            Air::Inflate => {
                let _ = self.pumps.set_high();
            }
            Air::Vent => {
                let _ = self.vent.set_high();
            }
        }
    }
}
