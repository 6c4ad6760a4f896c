//! `flyvine sweep` and `flyvine merge`: the same bytes however the work was cut up, and however it was interrupted.

mod common;

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::OnceLock;
use std::time::Duration;

use common::{demo_run, flyvine};
use tempfile::TempDir;

const ROWS: usize = 16;

/// A sweep of [`ROWS`] swings, and the bytes of its table when nothing interrupts it.
struct Baseline {
    _folder: TempDir,
    sweep: PathBuf,
    table: Vec<u8>,
}

fn baseline() -> &'static Baseline {
    static BASELINE: OnceLock<Baseline> = OnceLock::new();
    BASELINE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let sweep = write_sweep(folder.path(), "");
        let out = folder.path().join("whole");
        flyvine()
            .args(["sweep", text(&sweep), "--out", text(&out)])
            .assert()
            .success();
        Baseline {
            table: table(&out),
            sweep,
            _folder: folder,
        }
    })
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn table(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("results.parquet")).unwrap()
}

fn swing_plan() -> PathBuf {
    demo_run().join("experiments/swing_ES/plan.json")
}

fn write_sweep(folder: &Path, more: &str) -> PathBuf {
    let path = folder.join("sweep.toml");
    let contents = format!(
        "name = \"wind and payload\"\nplans = [{:?}]\nseeds = 4\n{more}\n\
         [grid]\n\"payload.tip_mass_kg\" = [0.0, 0.02]\n\"wind.mean_m_s.0\" = [0.0, 0.8]\n\
         [spread]\n\"arm.tip_mass_kg\" = {{ relative = 0.1 }}\n\
         [success]\ntarget_miss_m = 0.3\n",
        text(&swing_plan())
    );
    std::fs::write(&path, contents).unwrap();
    path
}

fn journal_lines(out: &Path) -> Vec<String> {
    let Ok(listing) = std::fs::read_dir(out.join("journal")) else {
        return Vec::new();
    };
    let journals = listing.map(|entry| std::fs::read_to_string(entry.unwrap().path()).unwrap_or_default());
    journals
        .flat_map(|journal| journal.lines().map(str::to_owned).collect::<Vec<_>>())
        .collect()
}

#[test]
fn a_sweep_killed_again_and_again_ends_with_the_same_bytes() {
    let Baseline {
        sweep, table: whole, ..
    } = baseline();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("killed");
    let mut kills = 0;
    loop {
        let before = journal_lines(&out).len();
        let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_flyvine"))
            .args(["sweep", text(sweep), "--out", text(&out)])
            .env("RAYON_NUM_THREADS", if kills % 2 == 0 { "1" } else { "3" })
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break Some(status);
            }
            if journal_lines(&out).len() >= before + 3 {
                child.kill().unwrap(); // SIGKILL
                child.wait().unwrap();
                break None;
            }
            std::thread::sleep(Duration::from_millis(1));
        };
        match status {
            Some(status) => {
                assert!(status.success());
                break;
            }
            None => kills += 1,
        }
    }
    assert!(kills >= 2, "the sweep was too fast to be killed");
    assert_eq!(&table(&out), whole);
    let mut keys: Vec<String> = journal_lines(&out)
        .iter()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .map(|line| line["key"].as_str().unwrap().to_owned())
        .collect();
    keys.sort();
    let computed = keys.len();
    keys.dedup();
    assert_eq!((computed, keys.len()), (ROWS, ROWS), "a row was computed twice");
}

#[test]
fn shards_of_other_machines_make_the_same_table_and_more_seeds_only_add_rows() {
    let Baseline {
        sweep, table: whole, ..
    } = baseline();
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
    let shard = |out: &Path, shard: &str| {
        flyvine()
            .args(["sweep", text(sweep), "--out", text(out), "--shard", shard])
            .assert()
            .success();
    };
    shard(&a, "1/2");
    let missing = flyvine()
        .args(["merge", text(sweep), "--out", text(&a)])
        .assert()
        .code(2);
    let said = String::from_utf8_lossy(&missing.get_output().stderr).into_owned();
    assert!(said.contains("8 of 16 rows are missing"), "{said}");
    shard(&b, "2/2");
    flyvine()
        .args(["merge", text(sweep), "--out", text(&a), "--from", text(&b)])
        .assert()
        .success();
    assert_eq!(&table(&a), whole);

    // The same cells with one seed more, in the same folder.
    let more = folder.path().join("more");
    std::fs::create_dir(&more).unwrap();
    let contents = std::fs::read_to_string(sweep).unwrap();
    let larger = more.join("sweep.toml");
    std::fs::write(&larger, contents.replace("seeds = 4", "seeds = 5")).unwrap();
    let run = flyvine()
        .args(["sweep", text(&larger), "--out", text(&b)])
        .assert()
        .success();
    let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert!(said.contains("20 rows: 12 computed now, 8 before"), "{said}");
}

#[test]
fn a_slurm_script_runs_its_own_command_lines() {
    let Baseline {
        sweep, table: whole, ..
    } = baseline();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("slurm out");
    let script = folder.path().join("job.sh");
    flyvine()
        .args(["sweep", text(sweep), "--out", text(&out)])
        .args(["--slurm", text(&script), "--shards", "2"])
        .assert()
        .success();
    let bash = |arguments: &[&str], task: &str| {
        let binary = Path::new(env!("CARGO_BIN_EXE_flyvine")).parent().unwrap();
        let path = format!("{}:{}", text(binary), std::env::var("PATH").unwrap());
        let status = std::process::Command::new("bash")
            .args(arguments)
            .env("PATH", path)
            .env("SLURM_ARRAY_TASK_ID", task)
            .stderr(Stdio::null())
            .status()
            .unwrap();
        assert!(status.success(), "{arguments:?}");
    };
    bash(&["-n", text(&script)], "");
    bash(&[text(&script)], "1");
    bash(&[text(&script)], "2");
    flyvine()
        .args(["merge", text(sweep), "--out", text(&out)])
        .assert()
        .success();
    assert_eq!(&table(&out), whole);
    let words = std::fs::read_to_string(&script).unwrap();
    assert!(words.contains("#SBATCH --array=1-2\n"), "{words}");
}

#[test]
fn a_row_is_what_fly_and_score_say() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let plan = swing_plan();
    std::fs::write(
        at("one.toml"),
        format!(
            "name = \"one\"\nplans = [{:?}]\nfirst_seed = 7\n[grid]\n\"payload.tip_mass_kg\" = [0.03]\n",
            text(&plan)
        ),
    )
    .unwrap();
    std::fs::write(at("vehicle.toml"), "[payload]\ntip_mass_kg = 0.03\n").unwrap();
    let swept = flyvine()
        .args([
            "sweep",
            text(&at("one.toml")),
            "--out",
            text(&at("out")),
            "--json",
        ])
        .assert()
        .success();
    let summary: serde_json::Value = serde_json::from_slice(&swept.get_output().stdout).unwrap();
    let vehicle = format!("sim:{}", text(&at("vehicle.toml")));
    flyvine()
        .args(["fly", text(&plan), "--vehicle", &vehicle, "--seed", "7"])
        .args(["--out", text(&at("flight.csv"))])
        .assert()
        .success();
    let scored = flyvine()
        .args(["score", text(&at("flight.csv")), "--plan", text(&plan), "--json"])
        .assert()
        .success();
    let score: serde_json::Value = serde_json::from_slice(&scored.get_output().stdout).unwrap();
    let worst = &summary["worst"][0];
    assert_eq!(worst["error_m"], score["target_miss_m"]);

    // Its replay is a run of its own, with the same flight.
    let key = &worst["key"].as_str().unwrap()[..8];
    flyvine()
        .args([
            "sweep",
            text(&at("one.toml")),
            "--out",
            text(&at("out")),
            "--replay",
            key,
        ])
        .assert()
        .success();
    let replays = at("out").join("replays");
    let replay = std::fs::read_dir(&replays)
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let again = std::fs::read(replay.join("experiments/swing_ES/flight.csv")).unwrap();
    assert_eq!(again, std::fs::read(at("flight.csv")).unwrap());
    flyvine().args(["report", text(&replay)]).assert().success();
}

#[test]
fn what_cannot_be_swept_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_sweep(folder.path(), "");
    let whole = std::fs::read_to_string(&path).unwrap();
    let refused = |from: &str, to: &str, expected: &[&str]| {
        std::fs::write(&path, whole.replace(from, to)).unwrap();
        let assert = flyvine()
            .args(["sweep", text(&path), "--out", text(&folder.path().join("out"))])
            .assert()
            .code(2);
        let said = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
        for words in expected {
            assert!(said.contains(words), "`{words}` is not in: {said}");
        }
    };
    refused(
        "payload.tip_mass_kg",
        "payload.mass_kg",
        &["`payload.mass_kg`", "path of a number"],
    );
    refused(
        "[0.0, 0.8]",
        "[0.0, 99.0]",
        &["wind.mean_m_s.0", "99", "-20 and 20"],
    );
    refused(
        "relative = 0.1",
        "relative = 2.0",
        &["arm.tip_mass_kg", "relative = share"],
    );
    refused("seeds = 4", "seeds = 0", &["seeds", "at least 1"]);
    refused("seeds = 4", "seed = 4", &["unknown field `seed`"]);
}
