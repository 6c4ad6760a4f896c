//! The only place that prints: results to stdout, everything else to stderr.

use std::io::Write;
use std::time::Duration;

use comfy_table::{CellAlignment, Table, presets::UTF8_HORIZONTAL_ONLY};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rustix::time::{ClockId, clock_gettime};

use crate::outcome::{Blame, Failure};

/// A line of log to stderr.
pub fn say(message: &str) {
    // A closed stderr is no reason to stop.
    let _ = writeln!(std::io::stderr(), "{message}");
}

/// A result to stdout. A reader that went away (`| head`) is no error.
pub fn print(result: &str) -> Result<(), Failure> {
    match writeln!(std::io::stdout(), "{result}") {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error).or_internal(),
        _ => Ok(()),
    }
}

/// A result as JSON to stdout.
pub fn print_json(result: &impl serde::Serialize) -> Result<(), Failure> {
    print(&serde_json::to_string(result).or_internal()?)
}

/// A table with a header; columns after the first are right-aligned.
pub fn table(header: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut table = Table::new();
    table
        .load_style(UTF8_HORIZONTAL_ONLY)
        .set_header(header.to_vec())
        .add_rows(rows);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table.to_string()
}

/// A length in metres as centimetres; a dash where it is not finite.
pub fn centimetres(metres: f64) -> String {
    if metres.is_finite() {
        format!("{:.1}", 100.0 * metres)
    } else {
        "–".to_owned()
    }
}

/// A progress bar on stderr; where stderr is no terminal, plain lines through [`say`] are enough and the bar
/// stays hidden.
pub fn progress(length: u64, what: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{prefix:>12} [{bar:32}] {pos}/{len} {msg}  {elapsed}");
    bar.set_style(style.expect("the template is valid").progress_chars("=> "));
    bar.set_prefix(what.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    if bar.is_hidden() {
        say(&format!("{what} …"));
    }
    bar
}

/// The style of a bar that says when it will be done.
pub fn eta_style() -> ProgressStyle {
    let style = ProgressStyle::with_template(
        "{prefix:>12} [{bar:32}] {pos}/{len}  {elapsed}, {per_sec}, done in {eta}",
    );
    style.expect("the template is valid").progress_chars("=> ")
}

/// CPU time of this process, ms.
pub fn process_cpu_ms() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    1e3 * time.tv_sec as f64 + 1e-6 * time.tv_nsec as f64
}
