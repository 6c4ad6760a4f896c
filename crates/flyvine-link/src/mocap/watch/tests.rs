use super::*;

const TIP: [f64; 3] = [0.0, 0.0, 0.8];
const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// A body seen at 100 Hz beside a tip.
struct Scene {
    watch: BodyWatch,
    k: u32,
    tip: [f64; 3],
}

impl Scene {
    fn new() -> Self {
        Scene {
            watch: BodyWatch::new("drone", HygieneLimits::default()),
            k: 0,
            tip: TIP,
        }
    }

    fn see_pose(&mut self, position: [f64; 3], attitude: [f64; 4], tracked: bool) {
        self.k += 1;
        let captured_s = f64::from(self.k) / 100.0;
        let stamp = Stamp {
            server_s: 1.7e9 + captured_s,
            captured_s,
            delay_s: 0.0,
        };
        let pose = BodyPose {
            name: "drone".into(),
            position,
            attitude,
            tracked,
        };
        self.watch.take(&pose, stamp, &[(1, self.tip)]);
    }

    fn see(&mut self, x: f64) {
        self.see_pose([x, 0.0, 1.5], UPRIGHT, true);
    }

    fn x(&self) -> f64 {
        self.watch.credible.unwrap().position[0]
    }

    fn age_s(&self) -> f64 {
        f64::from(self.k) / 100.0 - self.watch.credible.unwrap().captured_s
    }
}

#[test]
fn flight_at_full_speed_is_clean() {
    let mut scene = Scene::new();
    for k in 0..300 {
        let t_s = f64::from(k) / 100.0;
        let half = 0.5 * (8.0 * t_s).sin();
        scene.see_pose(
            [(8.0 * t_s).sin(), 0.0, 1.5],
            [half.cos(), half.sin(), 0.0, 0.0],
            true,
        );
    }
    assert_eq!(scene.watch.counts, HygieneCounts::default());
    assert!((scene.watch.rate_hz().unwrap() - 100.0).abs() < 1e-6);
    assert_eq!(scene.age_s(), 0.0);
}

#[test]
fn repeated_poses_are_frozen_only_while_something_moves() {
    let mut scene = Scene::new();
    for _ in 0..50 {
        scene.see(0.0);
    }
    assert_eq!(scene.watch.counts, HygieneCounts::default());
    assert_eq!(scene.age_s(), 0.0);
    for k in 1..=30 {
        scene.tip[0] = 0.01 * f64::from(k);
        scene.see(0.0);
    }
    assert_eq!(scene.watch.counts.frozen, 30);
    assert!(
        (scene.age_s() - 0.3).abs() < 1e-9,
        "the age runs from the last new value"
    );
    scene.see(0.02);
    assert_eq!(scene.age_s(), 0.0);
}

#[test]
fn nonsense_is_refused_and_counted_by_cause() {
    let mut scene = Scene::new();
    scene.see(0.0);
    scene.see(f64::NAN);
    scene.see(f64::INFINITY);
    scene.see_pose([0.0, 0.0, 1.5], [0.0; 4], true);
    scene.see_pose([0.0, 0.0, 1.5], UPRIGHT, false);
    scene.k -= 1;
    scene.see(0.01);
    let expected = HygieneCounts {
        not_finite: 2,
        not_unit: 1,
        untracked: 1,
        late: 1,
        ..HygieneCounts::default()
    };
    assert_eq!(scene.watch.counts, expected);
    assert_eq!(scene.x(), 0.0);
}

#[test]
fn a_spike_is_refused_and_the_body_goes_on() {
    let mut scene = Scene::new();
    for k in 0..100 {
        let spike = if k % 10 == 5 { 0.5 } else { 0.0 };
        scene.see(0.01 * f64::from(k) + spike);
        assert!(scene.x() < 1.0);
    }
    assert_eq!(scene.watch.counts.jump, 10);
    assert_eq!(scene.watch.counts.reacquired, 0);
}

#[test]
fn a_lasting_jump_is_believed_only_when_a_flight_would_be_over() {
    let mut scene = Scene::new();
    scene.see(0.0);
    let mut refused = 0;
    while scene.x() == 0.0 {
        scene.see(1.0 + 1e-4 * f64::from(refused));
        refused += 1;
    }
    assert!((45..=55).contains(&refused), "{refused}");
    assert_eq!(scene.watch.counts.reacquired, 1);
}

#[test]
fn a_wandering_body_is_never_believed() {
    let mut scene = Scene::new();
    scene.see(0.0);
    for k in 0..400 {
        scene.see(if k % 2 == 0 { 1.0 } else { -1.5 });
    }
    assert_eq!(scene.x(), 0.0);
    assert_eq!(scene.watch.counts.jump, 400);
}

#[test]
fn a_swap_with_another_body_is_told_from_a_jump() {
    let mut scene = Scene::new();
    scene.see(0.0);
    for k in 0..100 {
        scene.see_pose([1e-3 * f64::from(k), 0.0, 0.8], UPRIGHT, true);
    }
    assert_eq!((scene.watch.counts.swapped, scene.watch.counts.jump), (100, 0));
    scene.see(1e-3);
    assert_eq!(scene.x(), 1e-3, "the right body is believed at once");
}

#[test]
fn signs_are_repaired_and_turns_refused() {
    let mut scene = Scene::new();
    scene.see(0.0);
    scene.see_pose([0.001, 0.0, 1.5], UPRIGHT.map(|c| -c), true);
    assert_eq!(scene.watch.credible.unwrap().attitude, UPRIGHT);
    assert_eq!(scene.watch.counts.sign_flip, 1);
    scene.see_pose([0.002, 0.0, 1.5], [0.0, 1.0, 0.0, 0.0], true);
    assert_eq!(scene.watch.counts.turn, 1);
    assert_eq!(scene.x(), 0.001);
}

#[test]
fn missing_frames_are_a_gap() {
    let mut scene = Scene::new();
    for k in 0..100 {
        scene.see(1e-3 * f64::from(k));
    }
    scene.k += 20;
    scene.see(0.2);
    assert_eq!(scene.watch.counts.gap, 1);
    assert!((scene.watch.longest_gap_s - 0.21).abs() < 1e-9);
}
