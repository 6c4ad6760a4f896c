//! A controller with a deadline: it computes on a thread of its own, and a tick that it misses is a tick without it.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use flyvine::control::{Controller, Proposal, Tick};
use flyvine::flight::StepReport;

type Answer = (usize, Proposal, Option<StepReport>);

/// The controller's stand-in on the flight's own thread.
struct Deadline {
    ticks: Sender<Tick>,
    answers: Receiver<Answer>,
    budget: Duration,
    /// The tick that is still being computed.
    busy: Option<usize>,
    report: Option<StepReport>,
}

impl Deadline {
    /// Waits for the answer to `knot`; older answers are thrown away.
    fn answer(&mut self, knot: usize, budget: Duration) -> Option<Proposal> {
        loop {
            match self.answers.recv_timeout(budget) {
                Ok((answered, proposal, report)) => {
                    if self.busy == Some(answered) {
                        self.busy = None;
                    }
                    if answered == knot {
                        self.report = report;
                        return Some(proposal);
                    }
                }
                Err(RecvTimeoutError::Timeout) => return None,
                // The controller panicked.
                Err(RecvTimeoutError::Disconnected) => return Some(Proposal::Failed),
            }
        }
    }
}

impl Controller for Deadline {
    fn propose(&mut self, tick: &Tick) -> Proposal {
        self.report = None;
        // An answer to an earlier tick that has come in the meantime is too old to be sent.
        if let Some(earlier) = self.busy
            && let Some(Proposal::Failed) = self.answer(earlier, Duration::ZERO)
        {
            return Proposal::Failed;
        }
        if self.busy.is_some() {
            return Proposal::Late;
        }
        if self.ticks.send(*tick).is_err() {
            return Proposal::Failed;
        }
        self.busy = Some(tick.knot);
        self.answer(tick.knot, self.budget).unwrap_or(Proposal::Late)
    }

    fn report(&self) -> Option<StepReport> {
        self.report
    }
}

/// Runs `flight` with a stand-in for `controller` that answers within `budget` or is [`Proposal::Late`]: a solver that hangs
/// is then the supervisor's to notice, and set-points go on leaving. Returns once the controller's last step is done.
pub fn with_deadline<R>(
    controller: &mut (dyn Controller + Send),
    budget: Duration,
    flight: impl FnOnce(&mut dyn Controller) -> R,
) -> R {
    let (ticks, ticks_in) = channel::<Tick>();
    let (answers_out, answers) = channel();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while let Ok(tick) = ticks_in.recv() {
                let proposal = controller.propose(&tick);
                if answers_out
                    .send((tick.knot, proposal, controller.report()))
                    .is_err()
                {
                    return;
                }
            }
        });
        let mut deadline = Deadline {
            ticks,
            answers,
            budget,
            busy: None,
            report: None,
        };
        flight(&mut deadline)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flyvine::link::Observation;
    use std::sync::mpsc::sync_channel;

    fn tick(knot: usize) -> Tick {
        Tick {
            knot,
            observation: Observation {
                t_s: 0.0,
                quadrotor: None,
                end_effector: None,
            },
            held_command: [0.0; 3],
        }
    }

    /// Answers tick 1 only when it is told to.
    struct Hangs(Receiver<()>);

    impl Controller for Hangs {
        fn propose(&mut self, tick: &Tick) -> Proposal {
            if tick.knot == 1 {
                self.0.recv().unwrap();
            }
            Proposal::Command([tick.knot as f64; 3])
        }
    }

    #[test]
    fn a_hanging_controller_is_late_and_its_old_answer_is_never_used() {
        let (go_on, wait) = sync_channel(1);
        with_deadline(&mut Hangs(wait), Duration::from_millis(20), |controller| {
            // The first answer may take as long as the machine likes.
            let mut first = controller.propose(&tick(0));
            while first == Proposal::Late {
                first = controller.propose(&tick(0));
            }
            assert_eq!(first, Proposal::Command([0.0; 3]));
            assert_eq!(controller.propose(&tick(1)), Proposal::Late);
            assert_eq!(
                controller.propose(&tick(2)),
                Proposal::Late,
                "still busy with tick 1"
            );
            go_on.send(()).unwrap();
            let mut proposal = Proposal::Late;
            for knot in 3..200 {
                proposal = controller.propose(&tick(knot));
                if let Proposal::Command(command) = proposal {
                    assert_eq!(command, [knot as f64; 3]);
                    break;
                }
                // While it is busy, no answer comes at once.
                std::thread::sleep(Duration::from_millis(5));
            }
            assert!(matches!(proposal, Proposal::Command(_)), "it comes back");
        });
    }
}
