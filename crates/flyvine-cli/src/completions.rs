//! `flyvine completions`: what a shell needs to complete flyvine's arguments.

use clap::{Args, Command};
use clap_complete::{Shell, generate};

use crate::console::print;
use crate::outcome::{Blame, CommandResult, Outcome};

/// Print completions for a shell.
///
///   flyvine completions bash > ~/.local/share/bash-completion/completions/flyvine
///   flyvine completions zsh > ~/.zfunc/_flyvine      (with ~/.zfunc in fpath)
///   flyvine completions fish > ~/.config/fish/completions/flyvine.fish
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct CompletionsArguments {
    /// The shell.
    shell: Shell,
}

/// Runs `flyvine completions`.
pub fn run(arguments: &CompletionsArguments, mut command: Command) -> CommandResult {
    let mut script = Vec::new();
    generate(arguments.shell, &mut command, "flyvine", &mut script);
    print(String::from_utf8(script).or_internal()?.trim_end())?;
    Ok(Outcome::Done)
}
