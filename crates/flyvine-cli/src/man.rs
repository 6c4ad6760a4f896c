//! `flyvine man`: manual pages.

use std::path::PathBuf;

use clap::{Args, Command};
use clap_mangen::Man;

use crate::console::say;
use crate::outcome::{Blame, CommandResult, Failure, Outcome};

/// Write manual pages: flyvine.1, and one page for each command (flyvine-fit.1, …).
///
///   flyvine man --out ~/.local/share/man/man1
///   man flyvine-fly
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct ManArguments {
    /// Folder to write them to.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs `flyvine man`.
pub fn run(arguments: &ManArguments, command: &Command) -> CommandResult {
    write(arguments, command.clone(), "flyvine")?;
    let commands = command.get_subcommands().filter(|command| !command.is_hide_set());
    let mut pages = 1;
    for command in commands {
        let name = format!("flyvine-{}", command.get_name());
        // clap wants the names of its commands for the whole run of the program.
        write(
            arguments,
            command.clone().name(name.clone().leak() as &str),
            &name,
        )?;
        pages += 1;
    }
    say(&format!("wrote {pages} pages to {}", arguments.out.display()));
    Ok(Outcome::Done)
}

fn write(arguments: &ManArguments, command: Command, name: &str) -> Result<(), Failure> {
    let mut page = Vec::new();
    Man::new(command).render(&mut page).or_internal()?;
    flyvine::file::write_whole(&arguments.out.join(format!("{name}.1")), &page).or_input()
}
