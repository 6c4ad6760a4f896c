//! The firmware itself, on an emulated Cortex-M0 (qemu's micro:bit), spoken to over its serial line.
//!
//! Needs qemu-system-arm and the image: `.ci/firmware` makes and installs them. Where they are absent the tests say that
//! they skip; with an image named by FLYVINE_FIRMWARE_IMAGE, they fail.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use flyvine_link::arm::{Arm, EmulatedBoard, FramedArm, Request, Setpoint, Telemetry};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vine_arm::{Air, Decoder, Frame, Message, Refusal, State};

/// One board at a time: the emulation keeps real time.
static ONE_BOARD: Mutex<()> = Mutex::new(());

/// A running board.
struct Board {
    emulated: EmulatedBoard,
    _turn: MutexGuard<'static, ()>,
}

/// Starts the firmware and waits until it speaks.
fn start_board() -> Option<Board> {
    let turn = ONE_BOARD.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let default = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../firmware/target/thumbv6m-none-eabi/release/microbit"
    );
    let image =
        std::env::var_os("FLYVINE_FIRMWARE_IMAGE").map_or_else(|| PathBuf::from(default), PathBuf::from);
    if !image.is_file() {
        return absent(&format!("no firmware image at {}", image.display()));
    }
    let emulated = match EmulatedBoard::start(&image) {
        Ok(emulated) => emulated,
        Err(error) if error.kind() == ErrorKind::NotFound => {
            return absent(&format!("qemu-system-arm: {error}"));
        }
        Err(error) => panic!("{error}"),
    };
    let mut board = Board {
        emulated,
        _turn: turn,
    };
    let mut telemetry = Vec::new();
    let until = Instant::now() + Duration::from_secs(10);
    while telemetry.is_empty() {
        assert!(Instant::now() < until, "no telemetry within 10 s of power-up");
        let mut decoder = Decoder::new();
        std::thread::sleep(Duration::from_millis(100));
        decoder.extend(&board.read(), |frame| telemetry.extend(frame.ok()));
    }
    Some(board)
}

fn absent(what: &str) -> Option<Board> {
    let required = std::env::var_os("FLYVINE_FIRMWARE_IMAGE").is_some();
    assert!(!required, "{what}");
    say(&format!("skipped: {what}"));
    None
}

/// A skip, and what was measured, must be seen: unlike `println!`, this is not captured.
fn say(what: &str) {
    let _ = writeln!(std::io::stderr(), "arm_firmware: {what}");
}

impl Board {
    /// What has arrived.
    fn read(&mut self) -> Vec<u8> {
        let mut bytes = vec![0; 4096];
        let count = match self.emulated.line.read(&mut bytes) {
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::WouldBlock => 0,
            Err(error) => panic!("the line failed: {error}"),
        };
        bytes.truncate(count);
        bytes
    }

    /// Writes as much as the line takes.
    fn write(&mut self, bytes: &[u8]) -> usize {
        match self.emulated.line.write(bytes) {
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::WouldBlock => 0,
            Err(error) => panic!("the line failed: {error}"),
        }
    }
}

/// A request, and what the arm must answer.
fn any_request(rng: &mut ChaCha8Rng) -> (Request, Result<(), Refusal>) {
    let setpoint = Setpoint {
        growth_rate_m_s: rng.random_range(-0.02..=0.02),
        pressure_kpa: rng.random_range(0.0..=2.0),
    };
    match rng.random_range(0..20) {
        0 => {
            let growth_rate_m_s = f32::NAN;
            (
                Request::Setpoint(Setpoint {
                    growth_rate_m_s,
                    ..setpoint
                }),
                Err(Refusal::GrowthRateNotFinite),
            )
        }
        1 => {
            let pressure_kpa = -0.1;
            (
                Request::Setpoint(Setpoint {
                    pressure_kpa,
                    ..setpoint
                }),
                Err(Refusal::PressureOutOfRange),
            )
        }
        2 => (Request::Resume, Ok(())),
        3 => (Request::SetLength(0.8), Err(Refusal::LengthMeasured)),
        _ => (Request::Setpoint(setpoint), Ok(())),
    }
}

/// Damages a frame between its two zeros, in one of the ways that lines do.
fn damage(rng: &mut ChaCha8Rng, frame: &[u8]) -> Vec<u8> {
    let good = &frame[1..frame.len() - 1];
    loop {
        let mut body = good.to_vec();
        match rng.random_range(0..6) {
            0 => {
                for _ in 0..rng.random_range(1..=8) {
                    let at = rng.random_range(0..body.len());
                    body[at] ^= 1 << rng.random_range(0..8);
                }
            }
            1 => {
                let from = rng.random_range(0..body.len());
                let to = rng.random_range(from..body.len());
                rng.fill(&mut body[from..=to]);
            }
            2 => {
                let at = rng.random_range(0..body.len() - 3);
                body.drain(at..at + rng.random_range(1..=3));
            }
            3 => {
                // Inside, where zeros among the new bytes cannot leave the frame whole.
                for _ in 0..rng.random_range(1..=5) {
                    let at = rng.random_range(1..body.len());
                    body.insert(at, rng.random());
                }
            }
            4 => body.truncate(rng.random_range(1..body.len())),
            _ => {
                body = vec![0; rng.random_range(60..200)];
                rng.fill(&mut body[..]);
            }
        }
        if body != good {
            let mut bytes = vec![0];
            bytes.extend(body);
            bytes.push(0);
            return bytes;
        }
    }
}

#[test]
fn ten_thousand_frames_with_damage() {
    const FRAMES: u16 = 10_000;
    /// Bytes on their way at most: less than the board's buffer.
    const WINDOW: usize = 128;
    let Some(mut board) = start_board() else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut expected: BTreeMap<u16, Result<(), Refusal>> = BTreeMap::new();
    let (mut good, mut damaged, mut answered, mut refused) = (0_u32, 0_u32, 0_u32, 0_u32);
    let mut last: Option<Telemetry> = None;
    let mut decoder = Decoder::new();
    let mut outbox: Vec<u8> = Vec::new();
    // Where each good frame ends, in bytes sent; and where the last one ends that was answered: damage gets no answer.
    let (mut ends, mut sent, mut arrived) = (BTreeMap::new(), 0, 0);
    let mut next = 0;
    let start = Instant::now();
    let mut progress = Instant::now();
    while next < FRAMES || !outbox.is_empty() || !expected.is_empty() {
        if outbox.is_empty() && next < FRAMES && (expected.is_empty() || sent - arrived < WINDOW) {
            let (request, answer) = any_request(&mut rng);
            let frame = Frame {
                sequence: next,
                message: Message::Request(request),
            }
            .encode();
            next += 1;
            // Half a window of nothing but damage: a good frame tells when it has arrived.
            let answerless = expected.is_empty() && sent - arrived > WINDOW / 2;
            if rng.random_bool(0.5) && !answerless {
                damaged += 1;
                outbox = damage(&mut rng, &frame);
            } else {
                good += 1;
                expected.insert(next - 1, answer);
                outbox = frame.to_vec();
                ends.insert(next - 1, sent + outbox.len());
            }
            sent += outbox.len();
        }
        let written = board.write(&outbox);
        outbox.drain(..written);
        let bytes = board.read();
        if written == 0 && bytes.is_empty() {
            std::thread::sleep(Duration::from_micros(200));
        }
        // Telemetry goes on whatever becomes of an answer.
        assert!(
            progress.elapsed() < Duration::from_secs(5),
            "no answer to {expected:?} after {next} frames; telemetry {last:?}"
        );
        decoder.extend(&bytes, |frame| {
            match frame.expect("the line to the host is clean") {
                Frame {
                    sequence,
                    message: Message::Acknowledgement(answer),
                } => {
                    // Each good frame once, with its own answer, and nothing else.
                    assert_eq!(expected.remove(&sequence), Some(answer), "answer to {sequence}");
                    answered += 1;
                    arrived = ends.remove(&sequence).expect("a frame that was sent");
                    progress = Instant::now();
                    refused += u32::from(answer.is_err());
                }
                Frame {
                    message: Message::Telemetry(telemetry),
                    ..
                } => last = Some(telemetry),
                other => panic!("{other:?}"),
            }
        });
    }
    let seconds = start.elapsed().as_secs_f64();
    // The counters once everything has been read.
    let settled = Instant::now() + Duration::from_millis(300);
    while Instant::now() < settled {
        decoder.extend(&board.read(), |frame| {
            if let Ok(Frame {
                message: Message::Telemetry(telemetry),
                ..
            }) = frame
            {
                last = Some(telemetry);
            }
        });
        std::thread::sleep(Duration::from_millis(10));
    }
    let last = last.expect("telemetry 20 times a second");
    say(&format!(
        "{FRAMES} frames in {seconds:.1} s: {good} good, all acknowledged ({refused} refused by name); {damaged} damaged, \
         none accepted (the board counts {} rejections)",
        last.frames_rejected
    ));
    assert_eq!(answered, good);
    assert_eq!(last.frames_received, good);
    // A damaged frame may fall into two, but never vanishes: its zeros stay.
    assert!(last.frames_rejected >= damaged);
}

#[test]
fn silence_and_noise_stop_growth_and_pumps_within_300_ms() {
    const ROUNDS: u32 = 6;
    let Some(mut board) = start_board() else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let clock = Instant::now();
    let now = || clock.elapsed().as_secs_f64();
    let mut arm = FramedArm::new(board.emulated.line.try_clone().unwrap(), now());
    // Growth at this rate takes nearly all of the pumps' air: they run until the end.
    let growing = Setpoint {
        growth_rate_m_s: 0.02,
        pressure_kpa: 2.0,
    };
    let mut slowest_ms = 0;
    for round in 0..ROUNDS {
        for _ in 0..8 {
            arm.poll(now()).unwrap();
            arm.send(now(), growing).unwrap();
            std::thread::sleep(Duration::from_millis(50));
        }
        arm.poll(now()).unwrap();
        let running = arm.status(now()).telemetry.unwrap();
        assert!(
            running.growth_duty > 0.5 && running.air == Air::Inflate,
            "round {round}: {running:?}"
        );

        // Silence; in every other round damaged set-points instead, which must not count for any.
        let mut heard = Vec::new();
        let mut decoder = Decoder::new();
        for tick in 0..60 {
            std::thread::sleep(Duration::from_millis(10));
            if round % 2 == 1 && tick % 5 == 0 {
                let message = Message::Request(Request::Setpoint(growing));
                let frame = Frame {
                    sequence: rng.random(),
                    message,
                }
                .encode();
                board.write(&damage(&mut rng, &frame));
            }
            decoder.extend(&board.read(), |frame| {
                if let Ok(Frame {
                    message: Message::Telemetry(telemetry),
                    ..
                }) = frame
                {
                    heard.push(telemetry);
                }
            });
        }
        // Telemetry comes at once when the state changes: the age in it is how long the silence took to be noticed.
        let stopped = heard
            .iter()
            .position(|telemetry| telemetry.state == State::Silent);
        let stopped = stopped.unwrap_or_else(|| panic!("round {round}: never stopped: {heard:?}"));
        slowest_ms = slowest_ms.max(heard[stopped].setpoint_age_ms.unwrap());
        for telemetry in &heard[stopped..] {
            assert_eq!(
                (telemetry.growth_duty, telemetry.air),
                (0.0, Air::Off),
                "round {round}"
            );
        }
        // And the spool stands still, once the motor has run down.
        let late: Vec<f32> = heard
            .iter()
            .filter(|telemetry| telemetry.setpoint_age_ms > Some(500))
            .filter_map(|telemetry| telemetry.length_m)
            .collect();
        assert!(
            late.len() > 1 && late.iter().all(|length| (length - late[0]).abs() < 1e-4),
            "{late:?}"
        );
    }
    say(&format!(
        "watchdog: growth and pumps off after at most {slowest_ms} ms of silence, by the board's clock, in {ROUNDS} rounds"
    ));
    assert!(slowest_ms <= 300);
}
