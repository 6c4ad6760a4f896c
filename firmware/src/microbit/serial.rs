//! The UART with a buffer: its own holds six bytes, half a millisecond's worth, less than a control step takes.

use core::cell::RefCell;
use core::convert::Infallible;

use critical_section::Mutex;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::Deque;
use nrf51_hal::pac::{Interrupt, NVIC, UART0, interrupt};
use nrf51_hal::uart::Uart;

/// What the interrupt and the main loop share.
struct Shared {
    uart: Uart<UART0>,
    received: Deque<u8, 256>,
}

static SHARED: Mutex<RefCell<Option<Shared>>> = Mutex::new(RefCell::new(None));

/// The line to the host: received bytes wait in a buffer, sent ones go out when the UART is ready.
pub struct Serial(());

impl Serial {
    /// Takes over a UART whose receive interrupt is enabled.
    pub fn start(uart: Uart<UART0>) -> Serial {
        critical_section::with(|token| {
            let received = Deque::new();
            SHARED.borrow_ref_mut(token).replace(Shared { uart, received });
        });
        // SAFETY: unmasking an interrupt is unsound only where it breaks a critical section made by masking it. There
        // is none: what the handler touches is behind `SHARED`, whose critical sections mask all interrupts.
        #[allow(unsafe_code)]
        unsafe {
            NVIC::unmask(Interrupt::UART0);
        }
        Serial(())
    }

    /// Sleeps until the next interrupt, unless bytes are waiting.
    pub fn sleep_if_empty(&mut self) {
        // Inside the critical section an interrupt cannot be served between the look and the sleep, but it still ends
        // the sleep.
        critical_section::with(|token| {
            if SHARED
                .borrow_ref(token)
                .as_ref()
                .is_none_or(|shared| shared.received.is_empty())
            {
                cortex_m::asm::wfi();
            }
        });
    }

    /// Runs `f` on what is shared, which is there as long as a `Serial` is.
    fn with<T>(&self, f: impl FnOnce(&mut Shared) -> T) -> Option<T> {
        critical_section::with(|token| SHARED.borrow_ref_mut(token).as_mut().map(f))
    }
}

/// Received bytes go to the buffer; where it is full they are lost, and the frame's checksum tells.
#[interrupt]
fn UART0() {
    critical_section::with(|token| {
        if let Some(shared) = SHARED.borrow_ref_mut(token).as_mut() {
            while shared.uart.read_ready().unwrap_or(false) {
                let mut byte = [0];
                if shared.uart.read(&mut byte) == Ok(1) {
                    let _ = shared.received.push_back(byte[0]);
                }
            }
        }
    });
}

impl ErrorType for Serial {
    type Error = Infallible;
}

impl ReadReady for Serial {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.with(|shared| !shared.received.is_empty()).unwrap_or(false))
    }
}

impl Read for Serial {
    /// Takes what is there, which may be nothing: the main loop asks [`ReadReady`] first.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let count = self.with(|shared| {
            let count = buffer.len().min(shared.received.len());
            for slot in &mut buffer[..count] {
                *slot = shared.received.pop_front().unwrap_or(0);
            }
            count
        });
        Ok(count.unwrap_or(0))
    }
}

impl WriteReady for Serial {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        self.with(|shared| shared.uart.write_ready()).unwrap_or(Ok(false))
    }
}

impl Write for Serial {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.with(|shared| shared.uart.write(bytes)).unwrap_or(Ok(0))
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        self.with(|shared| shared.uart.flush()).unwrap_or(Ok(()))
    }
}
