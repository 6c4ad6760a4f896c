//! Wakes the main loop once per control period. Time itself is TIMER0's.

use core::cell::RefCell;

use critical_section::Mutex;
use nrf51_hal::pac::{Interrupt, NVIC, TIMER1, interrupt};
use nrf51_hal::timer::{Periodic, Timer};

use crate::main_loop::PERIOD_US;

static TIMER: Mutex<RefCell<Option<Timer<TIMER1, Periodic>>>> = Mutex::new(RefCell::new(None));

/// Starts the wake-up calls.
pub fn start(peripheral: TIMER1) {
    let mut timer = Timer::periodic(peripheral);
    timer.enable_interrupt();
    timer.start(PERIOD_US);
    critical_section::with(|token| TIMER.borrow_ref_mut(token).replace(timer));
    // SAFETY: as for the UART's: what the handler touches is behind `TIMER`, and no critical section masks this alone.
    #[allow(unsafe_code)]
    unsafe {
        NVIC::unmask(Interrupt::TIMER1);
    }
}

#[interrupt]
fn TIMER1() {
    critical_section::with(|token| {
        if let Some(timer) = TIMER.borrow_ref(token).as_ref() {
            timer.reset_event();
        }
    });
}
