//! `--live` and `--foxglove`: a flight under way on the page, and in Foxglove.

use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use flyvine::flight::Flight;
use flyvine::task::Plan;

use super::broadcast::{Broadcast, LiveEnd, LiveFeed, LiveRow};
use super::content::{PageFlight, page_content};
use super::foxglove;
use super::server::{PageServer, open_browser};
use crate::console::say;
use crate::outcome::{Blame, Failure};
use flyvine::run::plan_experiment;

/// How long a flight waits for its page to open.
const PAGE_PATIENCE: Duration = Duration::from_secs(20);
/// Time for the watchers to take the last rows.
const LAST_ROWS: Duration = Duration::from_secs(2);

/// How a flight under way is shown.
#[derive(Args, Clone, Default)]
pub struct LiveArguments {
    /// Show the flight on a local page while it is flown, with an abort button; a simulated vehicle flies in real time.
    /// The flight starts when the page is open.
    #[arg(long)]
    live: bool,
    /// With --live: print the page's address and open no browser.
    #[arg(long, requires = "live")]
    no_open: bool,
    /// With --live: the page's port on 127.0.0.1; 0 takes any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 0, requires = "live")]
    port: u16,
    /// Offer the flight to Foxglove (open connection, ws://127.0.0.1:PORT); a simulated vehicle flies in real time.
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    foxglove: Option<u16>,
}

impl LiveArguments {
    /// Whether somebody shall be able to watch.
    pub fn is_watched(&self) -> bool {
        self.live || self.foxglove.is_some()
    }

    /// As arguments of another process that flies.
    pub fn pass_on(&self, command: &mut std::process::Command) {
        if self.live {
            command.args(["--live", "--port", &self.port.to_string()]);
        }
        if self.no_open {
            command.arg("--no-open");
        }
        if let Some(port) = self.foxglove {
            command.args(["--foxglove", &port.to_string()]);
        }
    }

    /// Starts the servers and waits until the page is open; `None` where nobody shall watch.
    pub fn start(&self, plan: &Plan) -> Result<Option<LiveSession>, Failure> {
        if !self.is_watched() {
            return Ok(None);
        }
        let (feed, broadcast) = Broadcast::start();
        if let Some(port) = self.foxglove {
            let address = foxglove::serve(port, Arc::clone(&broadcast))?;
            say(&format!(
                "Foxglove: open connection, Foxglove WebSocket, {address}"
            ));
        }
        if self.live {
            let flight = Flight {
                name: plan.task.name.clone(),
                samples: Vec::new(),
            };
            let planned = PageFlight {
                experiment: plan_experiment(plan, flight, Vec::new()).or_input()?,
                steps: Vec::new(),
                source: None,
            };
            let title = format!("Live: {}", plan.task.name);
            let content = page_content(&title, &[planned], true)?;
            let server = PageServer::start(content, self.port, Some(Arc::clone(&broadcast)))?;
            say(&format!("page: {}", server.url()));
            if !self.no_open {
                open_browser(server.url());
            }
            wait_for_page(&broadcast);
        }
        Ok(Some(LiveSession {
            feed,
            broadcast,
            rows: 0,
        }))
    }
}

/// A flight that is watched. What the flight loop calls of it never blocks, but for [`finish`](Self::finish).
pub struct LiveSession {
    feed: LiveFeed,
    broadcast: Arc<Broadcast>,
    rows: usize,
}

impl LiveSession {
    /// Shows one row.
    pub fn publish(&mut self, row: LiveRow) {
        self.rows += 1;
        self.feed.publish(row);
    }

    /// Whether the operator pressed the page's abort button: the flight loop then aborts through its supervisor.
    pub fn abort_requested(&self) -> bool {
        self.broadcast.abort_requested()
    }

    /// Says how the flight ended, and gives the watchers time to take the last rows.
    pub fn finish(self, text: &str, completed: bool) {
        let dropped = self.feed.dropped();
        if dropped > 0 {
            say(&format!(
                "warning: {dropped} of {} rows were not shown live",
                self.rows
            ));
        }
        let taken = self.rows - dropped as usize;
        let end = LiveEnd {
            text: text.to_owned(),
            completed,
        };
        self.broadcast.finish(taken, end);
        let started = Instant::now();
        while self.broadcast.viewers() > 0 && started.elapsed() < LAST_ROWS {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

fn wait_for_page(broadcast: &Broadcast) {
    say("waiting for the page to open …");
    let started = Instant::now();
    while broadcast.viewers() == 0 {
        if started.elapsed() > PAGE_PATIENCE {
            say("nobody opened the page: flying without");
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}
