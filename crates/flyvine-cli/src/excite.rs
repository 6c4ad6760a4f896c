//! `flyvine excite`: the next training flight.

use std::path::PathBuf;

use clap::Args;
use flyvine::DT;
use flyvine::flight::Configuration;
use flyvine::model::physical::{Room, design_flight, information_gain};
use flyvine::model::{Bank, Model};

use crate::console::{print, print_json, say, table};
use crate::flights::{configuration_label, load_flights};
use crate::outcome::{Blame, CommandResult, Outcome, bad_input};

/// Design the training flight that would improve a physical model most.
///
/// Commands are put together, inside the room and no livelier than swings, so that their simulation is as sensitive as
/// possible to what the fit left uncertain. Compared with recorded flights of the same duration, the gain is in nats:
/// one nat more halves, about, what is open in one direction of the parameters (e⁻¹ in standard errors). The result is
/// a table of commands (t_s, cmd_x, cmd_y, cmd_z, length_m, pressure_kpa) at 20 Hz.
///
///   flyvine excite bank.json --length 0.7 --pressure 0 --out excite.csv --compare recordings/ES_*.csv
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct ExciteArguments {
    /// The bank, of the physical family.
    #[arg(value_name = "BANK.json")]
    bank: PathBuf,
    /// Arm length to fly at, m; must be one of the bank's corners.
    #[arg(long, value_name = "METRES")]
    length: f64,
    /// Arm pressure to fly at, kPa gauge.
    #[arg(long, value_name = "KPA", default_value_t = 0.0)]
    pressure: f64,
    /// Duration of the flight, s.
    #[arg(long, default_value_t = 50.0)]
    duration: f64,
    /// Where to write the commands.
    #[arg(long, value_name = "COMMANDS.csv")]
    out: PathBuf,
    /// Recordings whose commands are judged beside the designed ones, cut to the same duration.
    #[arg(long, value_name = "FLIGHT", num_args = 1..)]
    compare: Vec<PathBuf>,
    /// Continuations tried per 3 s.
    #[arg(long, default_value_t = 40)]
    candidates: usize,
    /// Seed of the search.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `flyvine excite`.
pub fn run(arguments: &ExciteArguments) -> CommandResult {
    let bank = Bank::read(&arguments.bank).or_input()?;
    let configuration = Configuration {
        length_m: arguments.length,
        pressure_kpa: arguments.pressure,
    };
    let Model::Physical(model) = bank.at(configuration).or_input()? else {
        return bad_input(format!(
            "{}: a bank of the lag family; expected the physical family (`fit --family physical`)",
            arguments.bank.display()
        ));
    };
    let compared = load_flights(&arguments.compare)?;
    say(&format!("designing {} s …", arguments.duration));
    let commands = design_flight(
        &model,
        arguments.duration,
        Room::default(),
        arguments.candidates.max(1),
        arguments.seed,
    )
    .or_input()?;
    let mut gains = vec![(
        "designed".to_owned(),
        information_gain(&model, &commands).or_internal()?,
    )];
    for flight in &compared {
        let mut own: Vec<[f64; 3]> = flight.samples.iter().map(|sample| sample.command).collect();
        own.truncate(commands.len());
        let seconds = own.len() as f64 * DT;
        let name = format!("{} ({seconds:.0} s)", flight.name);
        gains.push((name, information_gain(&model, &own).or_input()?));
    }
    let mut text = String::from("t_s,cmd_x,cmd_y,cmd_z,length_m,pressure_kpa\n");
    for (row, [x, y, z]) in commands.iter().enumerate() {
        let Configuration {
            length_m,
            pressure_kpa,
        } = configuration;
        text += &format!(
            "{:.2},{x:.6},{y:.6},{z:.6},{length_m},{pressure_kpa}\n",
            row as f64 * DT
        );
    }
    flyvine::file::write_whole(&arguments.out, text.as_bytes()).or_internal()?;
    if arguments.json {
        let gains: Vec<_> = gains
            .iter()
            .map(|(flight, nats)| serde_json::json!({ "flight": flight, "information_gain_nats": nats }))
            .collect();
        print_json(&gains)?;
    } else {
        let rows = gains
            .iter()
            .map(|(name, gain)| vec![name.clone(), format!("{gain:.1}")]);
        let header = format!("flight at {}", configuration_label(configuration, None));
        print(&table(&[&header, "information gain, nats"], rows))?;
    }
    say(&format!("wrote {}", arguments.out.display()));
    Ok(Outcome::Done)
}
