//! Flights in files: the extension `.mcap` means MCAP, everything else is CSV.

use std::path::Path;

use super::error::FlightError;
use super::{ControlStep, Flight, csv, mcap};

/// Reads a flight from a CSV or MCAP file. Its name is the file's, without the extension.
///
/// Attitudes within 1 % of unit length are normalized; their signs are left as they are
/// (see [`clean`](super::clean)).
///
/// # Errors
/// Whatever is not the format ([`parse_csv`](super::parse_csv)), with file, line or row, and column or
/// topic; values whose unit looks wrong; a median rate other than 20 Hz; an MCAP file that was cut off.
/// Single irregular time steps are no error: [`clean`](super::clean) reports them.
pub fn read_flight(path: &Path) -> Result<Flight, FlightError> {
    let (shown, bytes) = read(path)?;
    let flight = if is_mcap(path) {
        mcap::parse_mcap(&shown, &bytes)
    } else {
        csv::parse_csv(&shown, bytes.as_slice())
    }?;
    Ok(Flight {
        name: flight_name(path),
        ..flight
    })
}

/// Reads what is whole in an MCAP file that was cut off or damaged, up to the first damage.
///
/// # Errors
/// Not a single row is whole.
pub fn recover_flight(path: &Path) -> Result<Flight, FlightError> {
    let (shown, bytes) = read(path)?;
    let flight = mcap::recover_mcap(&shown, &bytes)?;
    Ok(Flight {
        name: flight_name(path),
        ..flight
    })
}

/// Writes a flight as a CSV or MCAP file, whole or not at all. Reading it gives the same numbers, bit for bit.
///
/// # Errors
/// A value that is not finite; the file cannot be written.
pub fn write_flight(path: &Path, flight: &Flight) -> Result<(), FlightError> {
    write_controlled_flight(path, flight, &[])
}

/// Writes a flight and what its controller reported of its steps, as [`write_flight`].
///
/// # Errors
/// As [`write_flight`].
pub fn write_controlled_flight(
    path: &Path,
    flight: &Flight,
    steps: &[ControlStep],
) -> Result<(), FlightError> {
    let shown = path.display().to_string();
    let bytes = if is_mcap(path) {
        mcap::format_mcap(&shown, flight, steps)?
    } else {
        csv::format_csv(&shown, flight, steps)?.into_bytes()
    };
    crate::file::write_whole(path, &bytes).map_err(|e| FlightError::in_file(&shown, e.into()))
}

/// Reads what a flight's controller reported of its steps; none where it reported nothing.
///
/// # Errors
/// The file cannot be read, or a report in it is not one.
pub fn read_control_steps(path: &Path) -> Result<Vec<ControlStep>, FlightError> {
    let (shown, bytes) = read(path)?;
    if is_mcap(path) {
        mcap::parse_steps(&shown, &bytes)
    } else {
        csv::parse_steps(&shown, &bytes)
    }
}

/// A flight's name: its file's, without folder and extension.
pub(super) fn flight_name(path: &Path) -> String {
    path.file_stem().map_or_else(
        || path.display().to_string(),
        |stem| stem.to_string_lossy().into_owned(),
    )
}

fn read(path: &Path) -> Result<(String, Vec<u8>), FlightError> {
    let shown = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|e| FlightError::in_file(&shown, e.into()))?;
    Ok((shown, bytes))
}

fn is_mcap(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}
