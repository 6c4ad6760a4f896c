//! Rows of a flight under way, from the flight loop to everyone who watches.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

use flyvine::control::FlownRow;
use flyvine::control::supervisor::{Event, Reason, State};
use flyvine::flight::{ControlStep, Sample};
use serde_json::{Value, json};

/// Rows that may wait between the flight loop and the broadcast: 12.8 s.
const QUEUE: usize = 256;

/// One row as it was flown.
#[derive(Debug, Clone, PartialEq)]
pub struct LiveRow {
    /// Row, from 0.
    pub row: usize,
    /// Knots of the plan.
    pub knots: usize,
    /// Poses and command.
    pub sample: Sample,
    /// Where the flight stands.
    pub state: State,
    /// Why it was ended, if it was.
    pub reason: Option<Reason>,
    /// What the supervisor had to say since the last row.
    pub events: Vec<Event>,
    /// What the controller reported.
    pub step: Option<ControlStep>,
    /// The arm's nodes, quadrotor end first, m, where the vehicle knows them.
    pub arm: Option<Vec<[f64; 3]>>,
    /// Rows that were lost before this one because nobody took them in time.
    pub dropped: u64,
}

impl LiveRow {
    /// A row of the flight loop, and the arm's nodes.
    pub fn new(flown: &FlownRow, arm: Option<Vec<[f64; 3]>>) -> Self {
        Self {
            row: flown.row,
            knots: flown.knots,
            sample: *flown.sample,
            state: flown.state,
            reason: flown.reason,
            events: flown.events.to_vec(),
            step: flown.step.copied(),
            arm,
            dropped: 0,
        }
    }
}

/// How the flight ended.
#[derive(Debug, Clone, PartialEq)]
pub struct LiveEnd {
    /// In words.
    pub text: String,
    /// Whether the plan was flown to its end.
    pub completed: bool,
}

/// The flight loop's side. It never blocks: a row that cannot be taken at once is dropped and counted.
pub struct LiveFeed {
    sender: SyncSender<LiveRow>,
    dropped: u64,
}

impl LiveFeed {
    /// Hands a row over.
    pub fn publish(&mut self, mut row: LiveRow) {
        row.dropped = self.dropped;
        if self.sender.try_send(row).is_err() {
            self.dropped += 1;
        }
    }

    /// Rows that nobody took in time.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

/// The rows so far, for any number of watchers.
#[derive(Default)]
pub struct Broadcast {
    progress: Mutex<Progress>,
    changed: Condvar,
    abort: AtomicBool,
    viewers: AtomicUsize,
}

#[derive(Default)]
struct Progress {
    rows: Vec<Arc<LiveRow>>,
    end: Option<LiveEnd>,
}

impl Broadcast {
    /// A feed, and the broadcast that a thread of its own takes its rows to.
    pub fn start() -> (LiveFeed, Arc<Self>) {
        let (sender, receiver) = sync_channel(QUEUE);
        let broadcast = Arc::new(Self::default());
        let taking = Arc::clone(&broadcast);
        std::thread::spawn(move || taking.take(&receiver));
        (LiveFeed { sender, dropped: 0 }, broadcast)
    }

    fn take(&self, receiver: &Receiver<LiveRow>) {
        while let Ok(row) = receiver.recv() {
            self.lock().rows.push(Arc::new(row));
            self.changed.notify_all();
        }
    }

    /// A thread that panicked while it held the lock leaves rows that are whole.
    fn lock(&self) -> MutexGuard<'_, Progress> {
        self.progress
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Says that the flight is over: `rows` were flown, `dropped` of them lost. Waits a moment for the last ones.
    pub fn finish(&self, rows: usize, end: LiveEnd) {
        let progress = self.lock();
        let (mut progress, _) = self
            .changed
            .wait_timeout_while(progress, Duration::from_millis(500), |progress| {
                progress.rows.len() < rows
            })
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        progress.end = Some(end);
        drop(progress);
        self.changed.notify_all();
    }

    /// The rows from `from` on, and the end with the last ones; waits for news, but not longer than `timeout`.
    pub fn wait(&self, from: usize, timeout: Duration) -> (Vec<Arc<LiveRow>>, Option<LiveEnd>) {
        let (progress, _) = self
            .changed
            .wait_timeout_while(self.lock(), timeout, |progress| {
                progress.rows.len() <= from && progress.end.is_none()
            })
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        (
            progress.rows.get(from..).unwrap_or_default().to_vec(),
            progress.end.clone(),
        )
    }

    /// Somebody wants the flight aborted.
    pub fn request_abort(&self) {
        self.abort.store(true, Ordering::Release);
    }

    /// Whether somebody does.
    pub fn abort_requested(&self) -> bool {
        self.abort.load(Ordering::Acquire)
    }

    /// Counts one who watches, as long as the answer lives.
    pub fn viewer(&self) -> Viewer<'_> {
        self.viewers.fetch_add(1, Ordering::AcqRel);
        Viewer(self)
    }

    /// How many watch.
    pub fn viewers(&self) -> usize {
        self.viewers.load(Ordering::Acquire)
    }
}

/// One who watches.
pub struct Viewer<'a>(&'a Broadcast);

impl Drop for Viewer<'_> {
    fn drop(&mut self) {
        self.0.viewers.fetch_sub(1, Ordering::AcqRel);
    }
}

/// What the page's WebSocket carries: `{"rows": […], "end": …}`; `web/src/flight.js` reads it.
pub fn rows_json(rows: &[Arc<LiveRow>], end: Option<&LiveEnd>) -> String {
    let rows: Vec<Value> = rows.iter().map(|row| row_json(row)).collect();
    let end = end.map(|end| json!({ "text": end.text, "completed": end.completed }));
    json!({ "rows": rows, "end": end }).to_string()
}

fn row_json(row: &LiveRow) -> Value {
    let LiveRow { sample, .. } = row;
    let configuration = sample.configuration;
    json!({
        "row": row.row,
        "knots": row.knots,
        "quadrotor": sample.quadrotor.map(|pose| pose.position),
        "attitude": sample.quadrotor.map(|pose| pose.attitude),
        "tip": sample.end_effector,
        "command": sample.command,
        "configuration": [configuration.length_m, configuration.pressure_kpa],
        "state": row.state.to_string(),
        "reason": row.reason.map(|reason| reason.to_string()),
        "events": row.events.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "step": row.step.map(|step| json!({ "ms": step.step_ms, "status": step.report.status })),
        "arm": row.arm,
        "dropped": row.dropped,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flyvine::flight::Configuration;

    fn row(row: usize) -> LiveRow {
        LiveRow {
            row,
            knots: 10_000,
            sample: Sample {
                t_s: 0.05 * row as f64,
                configuration: Configuration {
                    length_m: 0.7,
                    pressure_kpa: 0.0,
                },
                command: [0.0, 0.0, 1.5],
                command_velocity: None,
                quadrotor: None,
                end_effector: None,
            },
            state: State::Flying,
            reason: None,
            events: Vec::new(),
            step: None,
            arm: None,
            dropped: 0,
        }
    }

    #[test]
    fn a_watcher_gets_every_row_once_and_then_the_end() {
        let (mut feed, broadcast) = Broadcast::start();
        let watching = Arc::clone(&broadcast);
        let watcher = std::thread::spawn(move || {
            let mut seen = Vec::new();
            loop {
                let (rows, end) = watching.wait(seen.len(), Duration::from_secs(5));
                seen.extend(rows.iter().map(|row| row.row));
                if let Some(end) = end {
                    return (seen, end.text);
                }
            }
        });
        (0..200).for_each(|k| feed.publish(row(k)));
        let end = LiveEnd {
            text: "done".to_owned(),
            completed: true,
        };
        broadcast.finish(200, end);
        let (seen, text) = watcher.join().unwrap();
        assert_eq!(seen, (0..200).collect::<Vec<_>>());
        assert_eq!(text, "done");
        assert_eq!(feed.dropped(), 0);
    }

    #[test]
    fn a_flight_loop_that_nobody_follows_goes_on_and_counts() {
        // Nobody takes from this channel.
        let (sender, _receiver) = sync_channel(QUEUE);
        let mut feed = LiveFeed { sender, dropped: 0 };
        (0..QUEUE + 44).for_each(|k| feed.publish(row(k)));
        assert_eq!(feed.dropped(), 44);
    }

    #[test]
    fn rows_of_the_page_are_json_that_it_reads() {
        let text = rows_json(&[Arc::new(row(3))], None);
        let value: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(value["rows"][0]["row"], 3);
        assert_eq!(value["rows"][0]["state"], "flying");
        assert_eq!(value["rows"][0]["tip"], Value::Null);
        assert_eq!(value["end"], Value::Null);
    }
}
