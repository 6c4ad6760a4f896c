//! `--live` and `--foxglove`: a flight under way on the page, and in Foxglove.

use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use flyvine::flight::Flight;
use flyvine::task::Plan;
#[cfg(feature = "ros2")]
use flyvine_link::ros2::{RosAddress, RosPublisher, TOPICS};

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
    /// Publish poses, set-points and what the arm is told as topics of ROS 2, in this domain; on loopback, unless this
    /// machine's address in another network is named. A simulated vehicle flies in real time.
    #[cfg(feature = "ros2")]
    #[arg(long, value_name = "DOMAIN[@ADDRESS]", num_args = 0..=1, default_missing_value = "0")]
    ros2: Option<RosAddress>,
}

impl LiveArguments {
    /// Whether somebody shall be able to watch.
    pub fn is_watched(&self) -> bool {
        #[cfg(feature = "ros2")]
        let is_published = self.ros2.is_some();
        #[cfg(not(feature = "ros2"))]
        let is_published = false;
        self.live || self.foxglove.is_some() || is_published
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
        #[cfg(feature = "ros2")]
        if let Some(address) = self.ros2 {
            command.arg(format!("--ros2={address}"));
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
        #[cfg(feature = "ros2")]
        let ros2 = self
            .ros2
            .as_ref()
            .map(RosPublisher::start)
            .transpose()
            .or_input()?;
        #[cfg(feature = "ros2")]
        if ros2.is_some() {
            let names: Vec<&str> = TOPICS.iter().map(|(name, _)| *name).collect();
            say(&format!("ROS 2: {}", names.join(", ")));
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
            #[cfg(feature = "ros2")]
            ros2,
        }))
    }
}

/// A flight that is watched. What the flight loop calls of it never blocks, but for [`finish`](Self::finish).
pub struct LiveSession {
    feed: LiveFeed,
    broadcast: Arc<Broadcast>,
    rows: usize,
    #[cfg(feature = "ros2")]
    ros2: Option<RosPublisher>,
}

impl LiveSession {
    /// Shows one row.
    pub fn publish(&mut self, row: LiveRow) {
        self.rows += 1;
        #[cfg(feature = "ros2")]
        if let Some(ros2) = &self.ros2 {
            let since_1970 = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
            ros2.row(since_1970.map_or(0, |since| since.as_nanos() as u64), &row.sample);
        }
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
