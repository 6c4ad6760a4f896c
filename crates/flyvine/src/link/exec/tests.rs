//! Real children: `sh` and `python3`.

use std::sync::{Arc, Mutex};

use super::*;

const SHORT: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};

/// A child in Python that answers requests with `answer(k)`, k counted from the reset.
const PRELUDE: &str = r#"
import json, os, sys, time
def pose(k, **changes):
    reply = {"t_s": k * 0.05, "qr": [0, 0, 1.5], "q": [1, 0, 0, 0], "ee": [0, 0, 0.8], **changes}
    print(json.dumps(reply), flush=True)
def serve(answer, at_close=lambda: None):
    k = 0
    for line in sys.stdin:
        request = json.loads(line)
        if "close" in request:
            at_close()
            return
        k = 0 if "reset" in request else k + 1
        answer(k)
"#;

fn python(script: &str) -> ExecVehicle {
    python_with(script, Duration::from_secs(10), Duration::from_secs(2))
}

fn python_with(script: &str, reply_limit: Duration, close_limit: Duration) -> ExecVehicle {
    let command_line = shell_words::join(["python3", "-c", &format!("{PRELUDE}{script}")]);
    ExecVehicle::spawn(
        &command_line,
        ExecOptions {
            reply_limit,
            close_limit,
            stderr_sink: None,
        },
    )
    .unwrap()
}

fn exec_error(error: VehicleError) -> ExecError {
    match error {
        VehicleError::Exec(error) => error,
        other => panic!("not an exec error: {other}"),
    }
}

/// Resets and steps until the vehicle fails.
fn fly_to_fault(mut vehicle: ExecVehicle) -> ExecError {
    if let Err(error) = vehicle.reset(SHORT, 1) {
        return exec_error(error);
    }
    for _ in 0..20 {
        if let Err(error) = vehicle.step([0.0, 0.0, 1.5].into(), SHORT) {
            return exec_error(error);
        }
    }
    panic!("no fault in 20 steps");
}

#[test]
fn a_good_child_flies_is_reset_and_closes() {
    let mut vehicle = python("serve(lambda k: pose(k, ee=None if k == 2 else [0, 0, 0.8], note='ignored'))");
    for _ in 0..2 {
        assert_eq!(vehicle.reset(SHORT, u64::MAX).unwrap().t_s, 0.0);
        for k in 1..50 {
            let observation = vehicle.step([0.1, 0.2, 1.5].into(), SHORT).unwrap();
            assert!((observation.t_s - k as f64 * DT).abs() < 1e-12);
            assert_eq!(observation.end_effector.is_none(), k == 2);
        }
    }
    vehicle.close().unwrap();
    vehicle.close().unwrap();
    let error = exec_error(vehicle.step([0.0, 0.0, 1.5].into(), SHORT).unwrap_err());
    assert!(matches!(error.fault, ExecFault::Gone));
}

#[test]
fn the_child_sees_the_protocol() {
    let mut vehicle = ExecVehicle::spawn(
        r#"sh -c 'read reset; echo "$reset" >&2; echo "$REPLY"
                  read step; echo "$step" >&2; exit 7' "unused word""#,
        ExecOptions::default(),
    )
    .unwrap();
    let error = exec_error(
        vehicle
            .reset(
                Configuration {
                    length_m: 0.7,
                    pressure_kpa: 0.25,
                },
                3,
            )
            .unwrap_err(),
    );
    assert!(
        matches!(error.fault, ExecFault::Nonsense { .. }),
        "an empty line is nonsense: {error}"
    );
    assert_eq!(
        error.stderr,
        r#"{"reset":{"length_m":0.7,"pressure_kpa":0.25,"seed":3}}"#
    );

    let seen = Arc::new(Mutex::new(Vec::new()));
    struct Sink(Arc<Mutex<Vec<u8>>>);
    impl Write for Sink {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let script =
        r#"read reset; echo '{"t_s": 0, "qr": null, "q": null, "ee": null}'; read step; echo "$step" >&2"#;
    let options = ExecOptions {
        stderr_sink: Some(Box::new(Sink(Arc::clone(&seen)))),
        ..Default::default()
    };
    let mut vehicle = ExecVehicle::spawn(&shell_words::join(["sh", "-c", script]), options).unwrap();
    vehicle.reset(SHORT, 3).unwrap();
    let error = exec_error(vehicle.step([0.5, -1.0, 1.5].into(), SHORT).unwrap_err());
    assert!(matches!(error.fault, ExecFault::Died { .. }), "{error}");
    assert_eq!(
        error.stderr,
        r#"{"cmd":[0.5,-1.0,1.5],"length_m":0.7,"pressure_kpa":0.0}"#
    );
    assert_eq!(seen.lock().unwrap().trim_ascii_end(), error.stderr.as_bytes());
}

#[test]
fn the_child_sees_velocities_where_they_are_sent() {
    // The child answers with what it was sent: the position as the quadrotor's, the velocity as the tip's.
    let mut vehicle = python(
        "for k, line in enumerate(sys.stdin):\n\
         \x20   sent = json.loads(line)\n\
         \x20   if 'close' in sent: break\n\
         \x20   print(json.dumps(dict(t_s=k * 0.05, qr=sent.get('cmd'), q=[1, 0, 0, 0] if 'cmd' in sent else None,\n\
         \x20                         ee=sent.get('cmd_velocity'))), flush=True)",
    );
    vehicle.reset(SHORT, 1).unwrap();
    let setpoint = Setpoint {
        position: [0.1, -0.2, 1.5],
        velocity: Some([0.25, -1.5, 1e-3]),
    };
    let with = vehicle.step(setpoint, SHORT).unwrap();
    assert_eq!(with.quadrotor.unwrap().position, setpoint.position);
    assert_eq!(with.end_effector, setpoint.velocity);
    let without = vehicle.step(setpoint.position.into(), SHORT).unwrap();
    assert_eq!(without.end_effector, None);
    let broken = Setpoint {
        velocity: Some([0.0, f64::NAN, 0.0]),
        ..setpoint
    };
    let error = exec_error(vehicle.step(broken, SHORT).unwrap_err());
    assert!(matches!(error.fault, ExecFault::NotFinite(_)), "{error}");
}

#[test]
fn a_dying_child_is_named_with_its_status_and_last_words() {
    let error = fly_to_fault(python(
        "serve(lambda k: pose(k) if k < 3 else (print('motor on fire', file=sys.stderr), sys.exit(3)))",
    ));
    assert_eq!(error.steps, 2);
    let message = error.to_string();
    assert!(
        message.contains("died") && message.contains("exit status: 3"),
        "{message}"
    );
    assert!(message.contains("motor on fire"), "{message}");
}

#[test]
fn only_the_end_of_a_long_stderr_is_kept() {
    let error = fly_to_fault(python("sys.stderr.write('x' * 1000000 + 'the end'); sys.exit(1)"));
    assert!(error.stderr.len() <= 4096 && error.stderr.ends_with("the end"));
}

#[test]
fn a_child_that_closes_stdout_but_lives_on_is_dead_to_us() {
    let error = fly_to_fault(python("os.close(1); time.sleep(60)"));
    assert!(
        matches!(&error.fault, ExecFault::Died { status } if status == "still running"),
        "{error}"
    );
}

#[test]
fn a_stalling_child_is_named() {
    let stalls = "serve(lambda k: pose(k) if k < 2 else time.sleep(60))";
    let error = fly_to_fault(python_with(
        stalls,
        Duration::from_secs(3),
        Duration::from_secs(2),
    ));
    assert!(
        matches!(error.fault, ExecFault::Stalled { limit_s: 3.0 }),
        "{error}"
    );
    assert_eq!(error.steps, 1);
}

#[test]
fn a_line_that_drips_without_end_is_a_stall() {
    let drips = "
while True:
    sys.stdout.write('1'); sys.stdout.flush(); time.sleep(0.05)";
    let error = fly_to_fault(python_with(drips, Duration::from_secs(3), Duration::from_secs(2)));
    assert!(matches!(error.fault, ExecFault::Stalled { .. }), "{error}");
}

#[test]
fn a_huge_line_is_refused_without_being_read_whole() {
    let error = fly_to_fault(python("serve(lambda k: sys.stdout.write('[' * 100000000))"));
    assert!(
        matches!(&error.fault, ExecFault::TooLong { received, .. } if received.len() < 300),
        "{error}"
    );
}

#[test]
fn nonsense_is_named_with_what_was_received() {
    for (answer, named) in [
        ("print('ready', flush=True)", "received `ready`"),
        ("pose(k, qr=[0, 0, float('nan')])", "NaN"),
        ("pose(k, ee=[0, 0, float('inf')])", "Infinity"),
        ("pose(k, ee=[0, 0])", "length 2"),
        ("pose(k, q=[1, 1, 1, 1])", "norm of `q` is 2"),
        ("pose(k, q=None)", "of `qr` and `q`"),
        ("print('{\"t_s\": 0.05}', flush=True)", "missing field"),
        ("pose(k, t_s='soon')", "soon"),
        (
            "sys.stdout.buffer.write(bytes([255, 254, 10])), sys.stdout.flush()",
            "not JSON",
        ),
    ] {
        let error = fly_to_fault(python(&format!(
            "serve(lambda k: pose(k) if k < 1 else ({answer}))"
        )));
        assert!(
            matches!(error.fault, ExecFault::Nonsense { .. }),
            "{answer}: {error}"
        );
        assert!(error.to_string().contains(named), "{answer}: {error}");
    }
}

#[test]
fn time_must_follow_the_commands() {
    for answer in ["pose(1)", "pose(k + 1)", "pose(k, t_s=k * 0.051 + 0.02)"] {
        let error = fly_to_fault(python(&format!(
            "serve(lambda k: pose(k) if k < 2 else {answer})"
        )));
        assert!(
            matches!(error.fault, ExecFault::Clock { .. }),
            "{answer}: {error}"
        );
    }
    // A clock of the child's own, a little off the grid, is fine.
    let mut vehicle = python("serve(lambda k: pose(k, t_s=k * 0.0501 + 0.004))");
    vehicle.reset(SHORT, 1).unwrap();
    for _ in 0..100 {
        vehicle.step([0.0, 0.0, 1.5].into(), SHORT).unwrap();
    }
}

#[test]
fn doubled_replies_are_caught() {
    let error = fly_to_fault(python("serve(lambda k: (pose(k), pose(k)))"));
    // Which of the two depends on whether the second line has arrived when the next command is due.
    assert!(
        matches!(error.fault, ExecFault::Unasked { .. } | ExecFault::Clock { .. }),
        "{error}"
    );
}

#[test]
fn a_slow_or_unsuccessful_close_is_named() {
    for (at_close, status) in [
        ("time.sleep(60)", "still running"),
        ("sys.exit(4)", "exit status: 4"),
    ] {
        let script = format!("serve(pose, at_close=lambda: {at_close})");
        let mut vehicle = python_with(&script, Duration::from_secs(10), Duration::from_secs(2));
        vehicle.reset(SHORT, 1).unwrap();
        let error = exec_error(vehicle.close().unwrap_err());
        assert!(
            matches!(&error.fault, ExecFault::Close { status: found, .. } if found.contains(status)),
            "{error}"
        );
    }
}

#[test]
fn a_chatty_end_does_not_hold_the_exit_up() {
    let mut vehicle = python("serve(pose, at_close=lambda: [print('bye' * 1000) for _ in range(1000)])");
    vehicle.reset(SHORT, 1).unwrap();
    vehicle.close().unwrap();
}

#[test]
fn what_json_cannot_carry_is_not_sent() {
    let mut vehicle = python("serve(pose)");
    vehicle.reset(SHORT, 1).unwrap();
    let error = exec_error(vehicle.step([0.0, f64::NAN, 1.5].into(), SHORT).unwrap_err());
    assert!(matches!(error.fault, ExecFault::NotFinite(_)), "{error}");
}

#[test]
fn what_cannot_be_started_is_named() {
    for (command_line, named) in [
        ("", "empty"),
        ("python3 -c 'unclosed", "quote"),
        ("/no/such/simulator --fast", "cannot start it"),
    ] {
        let error = ExecVehicle::spawn(command_line, ExecOptions::default())
            .err()
            .unwrap();
        assert!(error.to_string().contains(named), "{error}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_dropped_vehicle_leaves_no_process_behind() {
    let vehicle = python("time.sleep(60)");
    let entry = format!("/proc/{}", vehicle.child.as_ref().unwrap().id());
    assert!(std::path::Path::new(&entry).exists());
    drop(vehicle);
    // A zombie would still have its entry.
    assert!(!std::path::Path::new(&entry).exists());
}
