//! The guide: its commands work as printed, its figures are theirs, its pages are all in the summary, its links lead
//! somewhere.
//!
//! A block ` ```sh,run ` is run here, all of them in the order of the summary in one folder, which also holds the
//! repository's `examples`. Blocks ` ```sh,slow ` take minutes and are run by
//!
//! ```text
//! cargo test --release -p flyvine-cli --test guide -- --ignored
//! ```
//!
//! Plain ` ```sh ` blocks need a browser, another machine or Python packages and are not run; their options are looked up.
//!
//! `![…](figures/NAME.svg "PATH")` shows what the commands make at PATH. With `FLYVINE_GUIDE_FIGURES=1` the figures are
//! made anew.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A chapter: its file's name and text.
type Chapter = (String, String);

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn flyvine() -> assert_cmd::Command {
    assert_cmd::Command::cargo_bin("flyvine").unwrap()
}

fn source() -> PathBuf {
    repository().join("docs/guide/src")
}

/// The chapters in the order of the summary.
fn chapters() -> Vec<Chapter> {
    let summary = std::fs::read_to_string(source().join("SUMMARY.md")).unwrap();
    links(&summary)
        .into_iter()
        .map(|file| {
            let text = std::fs::read_to_string(source().join(&file))
                .unwrap_or_else(|error| panic!("{file}: {error}"));
            (file, text)
        })
        .collect()
}

/// Where a text's links lead, `[…](HERE)`; empty ones left out.
fn links(text: &str) -> Vec<String> {
    text.split("](")
        .skip(1)
        .filter_map(|rest| rest.split(')').next())
        .map(|link| link.split(" \"").next().unwrap_or(link))
        .filter(|link| !link.is_empty())
        .map(str::to_owned)
        .collect()
}

/// The blocks with one of these info strings, with the number of their first line.
fn blocks(text: &str, wanted: &[&str]) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut open: Option<(bool, usize, String)> = None;
    for (i, line) in text.lines().enumerate() {
        match (line.strip_prefix("```"), &mut open) {
            (Some(info), None) => open = Some((wanted.contains(&info), i + 2, String::new())),
            (Some(_), Some(_)) => {
                if let Some((true, first, script)) = open.take() {
                    found.push((first, script));
                }
            }
            (None, Some((_, _, script))) => *script += &format!("{line}\n"),
            (None, None) => {}
        }
    }
    found
}

/// Runs the blocks of all chapters in one folder.
fn run_blocks(wanted: &[&str]) -> usize {
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(repository().join("examples"), folder.path().join("examples")).unwrap();
    let binary = assert_cmd::cargo::cargo_bin("flyvine");
    let path = format!(
        "{}:{}",
        binary.parent().unwrap().display(),
        std::env::var("PATH").unwrap_or_default()
    );
    let mut count = 0;
    for (file, text) in chapters() {
        for (line, script) in blocks(&text, wanted) {
            // What the library's own examples need is the repository itself.
            let script = script.replace(
                "cargo run ",
                &format!("cargo run --manifest-path {}/Cargo.toml ", repository().display()),
            );
            let output = Command::new("sh")
                .args(["-euc", &script])
                .current_dir(folder.path())
                .env("PATH", &path)
                .output()
                .unwrap();
            assert!(
                output.status.success(),
                "{file}, line {line}: {}\n{script}\n{}{}",
                output.status,
                String::from_utf8_lossy(&output.stdout),
                String::from_utf8_lossy(&output.stderr)
            );
            count += 1;
        }
        for (figure, made) in figures(&text) {
            check_figure(&source().join(figure), &folder.path().join(made));
        }
    }
    count
}

/// The figures of a chapter: its file, and what the commands make, `![…](FILE "MADE")`.
fn figures(text: &str) -> Vec<(String, String)> {
    let images = text.split("![").skip(1).filter_map(|rest| {
        let (link, _) = rest.split_once("](")?.1.split_once(')')?;
        let (file, made) = link.split_once(" \"")?;
        Some((file.to_owned(), made.trim_end_matches('"').to_owned()))
    });
    images.collect()
}

/// A figure in the guide is the one that the commands make: its words and colours are the same. Its numbers may have
/// moved since.
fn check_figure(shown: &Path, made: &Path) {
    let read = |path: &Path| {
        std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    let fresh = read(made);
    if std::env::var_os("FLYVINE_GUIDE_FIGURES").is_some_and(|value| value == "1") {
        std::fs::write(shown, &fresh).unwrap();
    }
    let outline = |svg: &str| -> (BTreeSet<String>, BTreeSet<String>) {
        let texts = svg.split('>').filter_map(|part| part.split('<').next());
        let words = texts.map(|text| text.replace(|c: char| !c.is_alphabetic(), ""));
        let colors = svg
            .split("stroke=\"")
            .skip(1)
            .filter_map(|rest| rest.split('"').next());
        (words.collect(), colors.map(str::to_owned).collect())
    };
    assert_eq!(outline(&read(shown)), outline(&fresh), "{}", shown.display());
}

#[test]
fn its_commands_work_as_printed() {
    assert!(run_blocks(&["sh,run"]) > 20);
}

#[test]
#[ignore = "minutes: fits physical models and compiles an example"]
fn its_slow_commands_work_as_printed_too() {
    assert!(run_blocks(&["sh,run", "sh,slow"]) > 22);
}

#[test]
fn every_page_is_in_the_summary() {
    let listed: Vec<String> = chapters().into_iter().map(|(file, _)| file).collect();
    for entry in std::fs::read_dir(source()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(
            !name.ends_with(".md") || name == "SUMMARY.md" || listed.contains(&name),
            "{name} is not in SUMMARY.md"
        );
    }
}

#[test]
fn links_and_inclusions_lead_somewhere() {
    for (file, text) in chapters() {
        for link in links(&text) {
            if link.contains("://") {
                continue;
            }
            let (page, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let page = if page.is_empty() { &file } else { page };
            let target = std::fs::read_to_string(source().join(page));
            let target = target.unwrap_or_else(|error| panic!("{file}: {link}: {error}"));
            let has = |anchor: &str| {
                target
                    .lines()
                    .any(|line| heading_anchor(line).as_deref() == Some(anchor))
            };
            assert!(
                anchor.is_empty() || has(anchor),
                "{file}: {link}: no such heading"
            );
        }
        for inclusion in text.split("{{#include ").skip(1) {
            let path = inclusion.split("}}").next().unwrap();
            assert!(source().join(path).exists(), "{file}: {path}");
        }
    }
}

/// What is not run at least names commands and options that there are.
#[test]
fn options_that_are_printed_exist() {
    let mut looked_up = 0;
    for (file, text) in chapters() {
        for (line, script) in blocks(&text, &["sh", "sh,run", "sh,slow"]) {
            for command in script.replace("\\\n", " ").lines() {
                let mut words = command
                    .split_whitespace()
                    .skip_while(|word| *word != "flyvine")
                    .skip(1);
                let Some(name) = words.next().filter(|name| !name.starts_with('-')) else {
                    continue;
                };
                let help = flyvine().args([name, "--help"]).assert().success();
                let help = String::from_utf8_lossy(&help.get_output().stdout).into_owned();
                let options = words
                    .take_while(|word| !["||", "|", "#"].contains(word))
                    .filter(|word| word.starts_with("--"));
                for option in options {
                    let known = help.split([' ', '\n', ',', '[', '=']).any(|word| word == option);
                    assert!(known, "{file}, line {line}: `flyvine {name}` has no {option}");
                    looked_up += 1;
                }
            }
        }
    }
    assert!(looked_up > 60);
}

/// The anchor that mdBook gives a heading.
fn heading_anchor(line: &str) -> Option<String> {
    let heading = line.strip_prefix('#')?.trim_start_matches('#').trim();
    Some(
        heading
            .to_lowercase()
            .chars()
            .filter_map(|c| match c {
                ' ' => Some('-'),
                c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
                _ => None,
            })
            .collect(),
    )
}

#[test]
fn manual_pages_and_completions_know_every_command() {
    let folder = tempfile::tempdir().unwrap();
    flyvine()
        .args(["man", "--out"])
        .arg(folder.path())
        .assert()
        .success();
    let page = |name: &str| std::fs::read_to_string(Path::new(folder.path()).join(name)).unwrap();
    assert!(page("flyvine.1").contains("Exit codes"));
    for shell in ["bash", "zsh", "fish"] {
        let output = flyvine().args(["completions", shell]).output().unwrap();
        let script = String::from_utf8(output.stdout).unwrap();
        for command in ["fit", "plan", "fly", "view", "score"] {
            assert!(script.contains(command), "{shell}: {command}");
            assert!(page(&format!("flyvine-{command}.1")).contains(&format!("flyvine\\-{command}")));
        }
    }
}
