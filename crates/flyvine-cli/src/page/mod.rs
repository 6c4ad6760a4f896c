//! The local page: replay of flights in 3-D with plots locked to it, and the same page live.
//!
//! ```text
//! flight loop ──LiveFeed──▶ Broadcast ──▶ page (WebSocket), Foxglove (WebSocket)
//!      ▲                        │
//!      └───── abort flag ◀──────┘  POST …/abort
//! ```
//!
//! Everything listens on the loopback interface only. The page's own code is in `web/`, bundled with the program.

mod assets;
mod broadcast;
mod content;
mod foxglove;
mod http;
mod live;
mod paced;
mod paper_curves;
mod server;

pub use broadcast::LiveRow;
pub use content::{PageFlight, page_content};
pub use live::{LiveArguments, LiveSession};
pub use paced::PacedVehicle;
pub use server::{PageServer, open_browser};
