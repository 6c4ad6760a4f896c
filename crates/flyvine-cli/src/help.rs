//! Help texts whose paragraphs flow to the terminal's width, though they are broken into lines in the source.

use clap::Command;

/// `command` and its subcommands with flowing help texts.
pub fn flowing(command: Command) -> Command {
    let text = command.get_long_about().map(|text| flow(&text.to_string()));
    let command = match text {
        Some(text) => command.long_about(text),
        None => command,
    };
    command.mut_subcommands(flowing)
}

/// Joins the lines of paragraphs. Indented lines are examples and stay as they are.
fn flow(text: &str) -> String {
    let is_prose = |line: &str| !line.is_empty() && !line.starts_with(' ');
    let mut flowed = String::with_capacity(text.len());
    let mut after_prose = false;
    for (index, line) in text.lines().enumerate() {
        if index > 0 {
            flowed.push(if after_prose && is_prose(line) { ' ' } else { '\n' });
        }
        flowed.push_str(line);
        after_prose = is_prose(line);
    }
    flowed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paragraphs_flow_and_examples_stay() {
        let text = "Fly a plan.\n\nIt is\nflown:\n\n  flyvine fly \\\n    plan.json\n  flyvine score\nDone\nat last.";
        let flowed =
            "Fly a plan.\n\nIt is flown:\n\n  flyvine fly \\\n    plan.json\n  flyvine score\nDone at last.";
        assert_eq!(flow(text), flowed);
    }

    #[test]
    fn every_command_is_reached() {
        let inner = Command::new("inner").long_about("a\nb");
        let command = flowing(Command::new("outer").subcommand(inner));
        let inner = command.get_subcommands().next().unwrap();
        assert_eq!(inner.get_long_about().unwrap().to_string(), "a b");
    }
}
