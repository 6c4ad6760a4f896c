use super::super::BodyPose;
use super::*;

const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
const SERVER_S: f64 = 1.7e9;

fn body(name: &str, position: [f64; 3]) -> BodyPose {
    BodyPose {
        name: name.into(),
        position,
        attitude: UPRIGHT,
        tracked: true,
    }
}

/// A source without sockets, fed by hand.
struct Bench {
    tracker: Tracker,
    epoch: Instant,
}

impl Bench {
    fn new(bodies: Option<Bodies>) -> Self {
        let epoch = Instant::now();
        Bench {
            tracker: Tracker::new(bodies, HygieneLimits::default(), epoch),
            epoch,
        }
    }

    fn at(&self, t_s: f64) -> Instant {
        self.epoch + Duration::from_secs_f64(t_s)
    }

    /// A frame captured at `t_s`, sent 2 ms later, arriving another 1 ms later.
    fn frame(&mut self, t_s: f64, bodies: Vec<BodyPose>) {
        let frame = Frame {
            captured_s: SERVER_S + t_s,
            sent_s: SERVER_S + t_s + 0.002,
            bodies,
        };
        let arrived = self.at(t_s + 0.003);
        self.tracker.take(Incoming::Frame(frame, arrived));
    }
}

#[test]
fn ages_run_from_the_capture() {
    let mut bodies = Bodies::named("drone", "tip");
    bodies.latency_ms = 5.0;
    let mut bench = Bench::new(Some(bodies));
    for k in 0..100 {
        let t_s = f64::from(k) / 100.0;
        bench.frame(
            t_s,
            vec![body("drone", [t_s, 0.0, 1.5]), body("tip", [t_s, 0.0, 0.8])],
        );
    }
    let latest = bench.tracker.latest(bench.at(1.04));
    let quadrotor = latest.quadrotor.unwrap();
    assert_eq!(quadrotor.pose.position, [0.99, 0.0, 1.5]);
    // The transport's 1 ms cannot be seen from one side.
    assert!(
        (quadrotor.age_s - (0.05 - 0.001 + 0.005)).abs() < 1e-6,
        "{quadrotor:?}"
    );
    let captured_s = quadrotor.captured.duration_since(bench.epoch).as_secs_f64();
    assert!((captured_s + quadrotor.age_s - 1.04).abs() < 1e-6);
    assert_eq!(latest.end_effector.unwrap().pose.position, [0.99, 0.0, 0.8]);
}

#[test]
fn nothing_is_invented_before_it_was_seen() {
    let mut bench = Bench::new(Some(Bodies::named("drone", "tip")));
    bench.frame(
        0.0,
        vec![body("wand", [0.0; 3]), body("drone", [0.0, 0.0, f64::NAN])],
    );
    assert_eq!(bench.tracker.latest(bench.at(0.1)), Latest::default());
    let status = bench.tracker.status(bench.at(0.1));
    let names: Vec<(&str, Option<&str>, u64)> = status
        .bodies
        .iter()
        .map(|body| (&*body.name, body.role, body.received))
        .collect();
    assert_eq!(
        names,
        [
            ("drone", Some("quadrotor"), 1),
            ("tip", Some("end effector"), 0),
            ("wand", None, 1)
        ]
    );
    assert_eq!(status.bodies[0].faults.not_finite, 1);
}

#[test]
fn swapped_labels_in_one_frame_are_seen_in_both_bodies() {
    let mut bench = Bench::new(Some(Bodies::named("drone", "tip")));
    for k in 0..200 {
        let t_s = f64::from(k) / 100.0;
        let (drone, tip) = ([t_s.sin(), 0.0, 1.5], [t_s.sin(), 0.0, 0.8]);
        let (drone, tip) = if (100..110).contains(&k) {
            (tip, drone)
        } else {
            (drone, tip)
        };
        bench.frame(t_s, vec![body("drone", drone), body("tip", tip)]);
        let latest = bench.tracker.latest(bench.at(t_s + 0.003));
        assert_eq!(latest.quadrotor.unwrap().pose.position[2], 1.5);
        assert_eq!(latest.end_effector.unwrap().pose.position[2], 0.8);
    }
    for body in bench.tracker.status(bench.at(2.0)).bodies {
        assert_eq!(body.faults.swapped, 10, "{body:?}");
    }
}

#[test]
fn time_stamps_that_are_no_numbers_are_counted_and_change_nothing() {
    let mut bench = Bench::new(None);
    let frame = Frame {
        captured_s: f64::NAN,
        sent_s: SERVER_S,
        bodies: vec![body("drone", [0.0; 3])],
    };
    let arrived = bench.at(0.0);
    bench.tracker.take(Incoming::Frame(frame, arrived));
    let status = bench.tracker.status(arrived);
    assert_eq!(
        (status.broken_stamps, status.bodies.len(), status.clock),
        (1, 0, None)
    );
}

#[test]
fn a_server_whose_clock_was_set_is_believed_again() {
    let mut bench = Bench::new(Some(Bodies::named("drone", "tip")));
    for k in 0..800 {
        let t_s = f64::from(k) / 100.0;
        let set_s = if k < 300 { 0.0 } else { -20.0 };
        let frame = Frame {
            captured_s: SERVER_S + t_s + set_s,
            sent_s: SERVER_S + t_s + set_s,
            bodies: vec![body("drone", [t_s.sin(), 0.0, 1.5])],
        };
        let arrived = bench.at(t_s + 0.001);
        bench.tracker.take(Incoming::Frame(frame, arrived));
        let age_s = bench
            .tracker
            .latest(bench.at(t_s + 0.001))
            .quadrotor
            .unwrap()
            .age_s;
        // Not believed at first; then its age is right.
        let expected = if (300..500).contains(&k) { t_s - 2.99 } else { 0.0 };
        assert!((age_s - expected).abs() < 0.02, "{t_s}: {age_s}");
    }
}
