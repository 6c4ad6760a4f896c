//! `flyvine onboard` as a process: it ends on a signal, with the arm stopped.

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Stdio};

use flyvine_link::arm::SoftwareArm;
use vine_arm::Limits;
use vine_arm::plant::PlantParameters;

#[test]
fn a_signal_ends_the_daemon_with_the_arm_stopped() {
    let arm = SoftwareArm::start(Limits::default(), PlantParameters::default(), 0.7).unwrap();
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_flyvine"))
        .args(["onboard", "--json", "--arm-listen", "127.0.0.1:0", "--arm"])
        .arg(arm.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut log = BufReader::new(daemon.stderr.take().unwrap());
    let mut line = String::new();
    log.read_line(&mut line).unwrap();
    assert!(
        line.starts_with("arm: /dev/") && line.contains("<-> udp 127.0.0.1:"),
        "{line}"
    );

    let id = daemon.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-TERM", &id])
            .status()
            .unwrap()
            .success()
    );
    line.clear();
    log.read_line(&mut line).unwrap();
    assert_eq!(line, "arm stopped\n");
    let mut summary = String::new();
    daemon
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut summary)
        .unwrap();
    assert!(summary.contains("\"arm_stopped\":true"), "{summary}");
    assert!(daemon.wait().unwrap().success());
}

#[test]
fn a_port_that_is_not_there_is_bad_input() {
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_flyvine"));
        command.arg("onboard").args(arguments).output().unwrap()
    };
    let output = run(&["--arm", "/dev/no-such-port", "--arm-listen", "127.0.0.1:0"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("/dev/no-such-port"));
    assert_eq!(run(&[]).status.code(), Some(2));
}
