//! The host's half of the arm's protocol: bytes in, bytes out, no line and no clock.

use std::collections::VecDeque;

use vine_arm::{Decoder, Encoded, Frame, Message, Refusal, Request, Setpoint, Telemetry};

/// A request unanswered for this long is lost, s.
const ANSWER_LIMIT_S: f64 = 0.25;

/// What is known of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmStatus {
    /// The newest telemetry.
    pub telemetry: Option<Telemetry>,
    /// Age of the newest telemetry, s.
    pub telemetry_age_s: Option<f64>,
    /// Since anything was heard from the arm, or since the line was opened, s. For an arm that cannot answer this is
    /// always zero: its silence means nothing.
    pub silence_s: f64,
    /// Requests accepted by the arm.
    pub acknowledged: u64,
    /// Requests refused by the arm.
    pub refused: u64,
    /// Why the newest of them was refused.
    pub refusal: Option<Refusal>,
    /// Requests that were never answered.
    pub unanswered: u64,
    /// Frames from the arm that were rejected as corrupt.
    pub rejected: u64,
    /// How often the arm's clock has begun anew: it lost power, or its own watchdog reset it.
    pub restarts: u64,
    /// What was asked for and has not been answered yet.
    pub asked: Option<Request>,
}

/// The host's half of the protocol.
#[derive(Debug, Clone)]
pub struct ArmClient {
    decoder: Decoder,
    sequence: u16,
    /// Sequence and time of every request without an answer yet, oldest first.
    waiting: VecDeque<(u16, f64)>,
    /// The pending question and the sequence numbers it was sent with last.
    asked: Option<(Request, Option<u16>)>,
    heard_s: f64,
    telemetry_s: f64,
    status: ArmStatus,
}

impl ArmClient {
    /// A client that has heard nothing yet.
    pub fn new(now_s: f64) -> ArmClient {
        ArmClient {
            decoder: Decoder::new(),
            sequence: 0,
            waiting: VecDeque::new(),
            asked: None,
            heard_s: now_s,
            telemetry_s: now_s,
            status: ArmStatus {
                telemetry: None,
                telemetry_age_s: None,
                silence_s: 0.0,
                acknowledged: 0,
                refused: 0,
                refusal: None,
                unanswered: 0,
                rejected: 0,
                restarts: 0,
                asked: None,
            },
        }
    }

    /// Asks for something that must not be lost: [`tick`](ArmClient::tick) sends it until it is answered.
    pub fn ask(&mut self, request: Request) {
        self.asked = Some((request, None));
    }

    /// The frame of this tick: what was asked for, as long as it is unanswered, else the set-point.
    pub fn tick(&mut self, now_s: f64, setpoint: Setpoint) -> Encoded {
        let sequence = self.sequence;
        let request = match &mut self.asked {
            Some((request, sent)) => {
                *sent = Some(sequence);
                *request
            }
            None => Request::Setpoint(setpoint),
        };
        self.frame(now_s, request)
    }

    /// One request as a frame, with the next sequence number.
    pub fn frame(&mut self, now_s: f64, request: Request) -> Encoded {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        self.forget_unanswered(now_s);
        self.waiting.push_back((sequence, now_s));
        let message = Message::Request(request);
        Frame { sequence, message }.encode()
    }

    /// Takes bytes from the arm.
    pub fn receive(&mut self, now_s: f64, bytes: &[u8]) {
        for &byte in bytes {
            match self.decoder.push(byte) {
                None => {}
                Some(Ok(frame)) => self.hear(now_s, frame),
                Some(Err(_)) => self.status.rejected += 1,
            }
        }
    }

    fn hear(&mut self, now_s: f64, frame: Frame) {
        match frame.message {
            Message::Acknowledgement(answer) => self.answered(now_s, frame.sequence, answer),
            Message::Telemetry(telemetry) => {
                self.heard_s = now_s;
                self.telemetry_s = now_s;
                let last = self.status.telemetry.replace(telemetry);
                // Half of the clock's range tells backwards from forwards.
                if last.is_some_and(|last| (telemetry.time_ms.wrapping_sub(last.time_ms) as i32) < 0) {
                    self.status.restarts += 1;
                }
            }
            // The host's own kinds are not for a host: an echo, or a wrong wire.
            Message::Request(_) => self.status.rejected += 1,
        }
    }

    fn answered(&mut self, now_s: f64, sequence: u16, answer: Result<(), Refusal>) {
        // An answer to nothing that was asked says nothing about this host's requests.
        let Some(index) = self.waiting.iter().position(|(waiting, _)| *waiting == sequence) else {
            return;
        };
        self.waiting.remove(index);
        self.heard_s = now_s;
        match answer {
            Ok(()) => self.status.acknowledged += 1,
            Err(refusal) => {
                self.status.refused += 1;
                self.status.refusal = Some(refusal);
            }
        }
        if self.asked.is_some_and(|(_, sent)| sent == Some(sequence)) {
            self.asked = None;
        }
    }

    fn forget_unanswered(&mut self, now_s: f64) {
        while self
            .waiting
            .front()
            .is_some_and(|(_, sent_s)| now_s - sent_s > ANSWER_LIMIT_S)
        {
            self.waiting.pop_front();
            self.status.unanswered += 1;
        }
    }

    /// What is known at `now_s`.
    pub fn status(&self, now_s: f64) -> ArmStatus {
        ArmStatus {
            telemetry_age_s: self.status.telemetry.map(|_| now_s - self.telemetry_s),
            silence_s: now_s - self.heard_s,
            asked: self.asked.map(|(request, _)| request),
            ..self.status
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vine_arm::{Device, Limits, Sensors, State};

    const STILL: Setpoint = Setpoint {
        growth_rate_m_s: 0.0,
        pressure_kpa: 0.4,
    };

    fn device() -> Device {
        Device::new(Limits::default()).unwrap()
    }

    /// What the device answers to `bytes`.
    fn answer(device: &mut Device, bytes: &[u8]) -> Vec<u8> {
        let mut answer = Vec::new();
        device.receive(bytes, |frame| answer.extend_from_slice(frame));
        answer
    }

    #[test]
    fn answers_are_counted_and_refusals_named() {
        let (mut client, mut device) = (ArmClient::new(0.0), device());
        let first = answer(&mut device, &client.tick(0.0, STILL));
        client.receive(0.01, &first);
        let growing = Setpoint {
            growth_rate_m_s: 0.01,
            ..STILL
        };
        let second = answer(&mut device, &client.tick(0.05, growing));
        client.receive(0.06, &second);
        let status = client.status(0.06);
        assert_eq!((status.acknowledged, status.refused), (1, 1));
        assert_eq!(status.refusal, Some(Refusal::LengthUnknown));
        // The same answer again is to nothing that was asked.
        client.receive(0.07, &second);
        assert_eq!(client.status(0.07).refused, 1);
    }

    #[test]
    fn lost_requests_are_counted_and_silence_is_told() {
        let mut client = ArmClient::new(10.0);
        for tick in 0..20 {
            client.tick(10.0 + 0.05 * f64::from(tick), STILL);
        }
        let status = client.status(11.0);
        assert_eq!(status.unanswered, 14);
        assert_eq!(status.silence_s, 1.0);
        assert_eq!(status.telemetry_age_s, None);
    }

    #[test]
    fn a_stop_is_repeated_until_it_is_answered() {
        let (mut client, mut device) = (ArmClient::new(0.0), device());
        client.ask(Request::Stop);
        // The first two are lost.
        client.tick(0.0, STILL);
        client.tick(0.05, STILL);
        let bytes = answer(&mut device, &client.tick(0.1, STILL));
        assert_eq!(device.controller().state(), State::Stopped);
        assert_eq!(client.status(0.1).asked, Some(Request::Stop));
        client.receive(0.11, &bytes);
        assert_eq!(client.status(0.11).asked, None);
    }

    #[test]
    fn a_clock_that_begins_anew_is_a_restart() {
        let mut client = ArmClient::new(0.0);
        let run = |client: &mut ArmClient| {
            let mut device = device();
            for _ in 0..30 {
                device.step(5_000, Sensors::default(), |frame| client.receive(0.0, frame));
            }
        };
        run(&mut client);
        assert_eq!(client.status(0.0).restarts, 0);
        run(&mut client);
        assert_eq!(client.status(0.0).restarts, 1);
    }
}
