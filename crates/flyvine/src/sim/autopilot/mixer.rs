//! Control allocation for four motors in X layout, with saturation in PX4's order of priority: roll and pitch
//! before collective thrust before yaw.

use nalgebra::Vector3;

/// Motors in PX4's order (front right, rear left, front left, rear right): signs of x, of y (FLU) and of the
/// yaw torque of a motor's thrust.
const MOTORS: [[f64; 3]; 4] = [
    [1.0, -1.0, 1.0],
    [-1.0, 1.0, 1.0],
    [1.0, 1.0, -1.0],
    [-1.0, -1.0, -1.0],
];

/// Geometry and limits of the four motors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mixer {
    /// Offset of a motor along body x and y, m.
    pub offset_m: f64,
    /// Yaw torque per thrust, m.
    pub torque_per_thrust_m: f64,
    /// Greatest thrust of one motor, N.
    pub max_n: f64,
}

impl Mixer {
    /// Thrusts of the four motors (N) for a collective thrust (N) and a torque (body axes, N m), each within
    /// 0 and the greatest.
    pub fn allocate(&self, collective: f64, torque: &Vector3<f64>) -> [f64; 4] {
        let tilt = MOTORS.map(|[x, y, _]| (y * torque.x - x * torque.y) / (4.0 * self.offset_m));
        let yaw = MOTORS.map(|[_, _, spin]| spin * torque.z / (4.0 * self.torque_per_thrust_m));
        // Roll and pitch shrink only if they need more than the motors' whole range …
        let spread = tilt.iter().fold(0.0_f64, |largest, t| largest.max(t.abs()));
        let scale = (0.5 * self.max_n / spread.max(1e-12)).min(1.0);
        let tilt = tilt.map(|t| scale * t);
        let spread = scale * spread;
        // … the collective moves to make room for them …
        let mean = (0.25 * collective).min(self.max_n - spread).max(spread);
        // … and yaw takes what is left.
        let mut share = 1.0_f64;
        for (t, y) in tilt.iter().zip(&yaw) {
            let (up, down) = (self.max_n - mean - t, mean + t);
            if *y > 0.0 {
                share = share.min(up.max(0.0) / y);
            } else if *y < 0.0 {
                share = share.min(down.max(0.0) / -y);
            }
        }
        std::array::from_fn(|i| (mean + tilt[i] + share * yaw[i]).clamp(0.0, self.max_n))
    }

    /// Collective thrust (N) and torque (body axes, N m) that four motor thrusts (N) make.
    pub fn wrench(&self, motors: &[f64; 4]) -> (f64, Vector3<f64>) {
        let mut torque = Vector3::zeros();
        for ([x, y, spin], thrust) in MOTORS.iter().zip(motors) {
            torque += *thrust
                * Vector3::new(
                    y * self.offset_m,
                    -x * self.offset_m,
                    spin * self.torque_per_thrust_m,
                );
        }
        (motors.iter().sum(), torque)
    }
}
