//! What one Riccati sweep costs: the solver's, which exploits the shift of a lagged model, against dense ones, for
//! N = 200 knots, 27 states, 3 commands; and how near it comes to the machine's speed on large matrices.
//!
//! ```text
//! cargo run --release -p flyvine --example riccati_sweep
//! ```
//!
//! Prints one JSON object; times are process-CPU µs, the minimum of interleaved rounds (the large product has its own).

#![allow(clippy::print_stdout)] // an example is a program

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use flyvine::model::{CommandInputs, LagModel};
use flyvine::trajopt::{Dynamics, Options, Problem, Solver};
use nalgebra::{DMatrix, Matrix3, SMatrix};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::time::{ClockId, clock_gettime};
use std::hint::black_box;

const KNOTS: usize = 200;
const STATE: usize = 27;
const FRESH: usize = 9;
const COMMAND: usize = 3;
const WIDTH: usize = STATE + COMMAND;
const ROUNDS: usize = 200;
/// Size of the matrices that the machine's speed is measured with.
const LARGE: usize = 512;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let dynamics = random_model()?;
    let problem = tracking_problem();
    let mut solver = Solver::new(&problem, &dynamics, Options::default())?;
    solver.solve();
    let transition = transition(&dynamics);
    let (mut nalgebra, mut faer) = (NalgebraSweep::new(&transition), FaerSweep::new(&transition));
    let large = Mat::<f64>::from_fn(LARGE, LARGE, |i, j| (i + 2 * j) as f64 / LARGE as f64);
    let mut product = Mat::<f64>::zeros(LARGE, LARGE);

    let mut fastest = [f64::INFINITY; 3];
    for _ in 0..ROUNDS {
        let times = [
            cpu_us(|| assert!(solver.sweep(), "the problem is convex")),
            cpu_us(|| nalgebra.run()),
            cpu_us(|| faer.run()),
        ];
        for (fastest, time) in fastest.iter_mut().zip(times) {
            *fastest = fastest.min(time);
        }
    }
    // Not in between: it would empty the caches, of which the dense sweeps, with one model for all knots, need little.
    let large = (0..ROUNDS)
        .map(|_| cpu_us(|| matmul(&mut product, Accum::Replace, &large, &large, 1.0, Par::Seq)))
        .fold(f64::INFINITY, f64::min);
    let agree = (nalgebra.value[(0, 0)] - faer.value[(0, 0)]).abs() <= 1e-9 * nalgebra.value[(0, 0)];
    assert!(agree, "the dense sweeps differ");

    let [structured, nalgebra, faer] = fastest;
    let gflops = |flops: usize, us: f64| flops as f64 / us * 1e-3;
    let sweep_flops = (KNOTS - 1) * structured_flops();
    println!(
        "{}",
        serde_json::json!({
            "knots": KNOTS,
            "structured_us": structured,
            "dense_nalgebra_us": nalgebra,
            "dense_faer_us": faer,
            "structured_gflops": gflops(sweep_flops, structured),
            "dgemm_gflops": gflops(2 * LARGE.pow(3), large),
        })
    );
    Ok(())
}

/// Multiplications and additions of one knot that exploits shift and symmetry.
fn structured_flops() -> usize {
    let shifted = STATE - FRESH;
    let upper = |rows: usize| rows * (rows + 1) / 2;
    let products = 2 * FRESH * (FRESH + COMMAND) * WIDTH + 2 * FRESH * (upper(STATE) + upper(shifted));
    let gains = 2 * COMMAND * COMMAND * STATE;
    let downdate = COMMAND * STATE * (STATE + 1);
    products + gains + downdate
}

fn cpu_us(mut work: impl FnMut()) -> f64 {
    let now = || {
        let time = clock_gettime(ClockId::ProcessCPUTime);
        time.tv_sec as f64 * 1e6 + time.tv_nsec as f64 * 1e-3
    };
    let started = now();
    work();
    now() - started
}

/// A lagged model without curvature, stable because its coefficients are small.
fn random_model() -> Result<LagModel, Box<dyn std::error::Error>> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let linear = (0..FRESH * WIDTH)
        .map(|_| random.random_range(-0.1..0.1))
        .collect();
    Ok(LagModel::new(
        STATE / FRESH,
        CommandInputs::Position,
        vec![0.0; FRESH],
        linear,
        &[],
    )?)
}

fn tracking_problem() -> Problem {
    let steps = KNOTS - 1;
    Problem {
        knots: KNOTS,
        start: vec![0.1; STATE],
        state_reference: vec![0.0; KNOTS * STATE],
        command_reference: vec![0.0; steps * COMMAND],
        state_weight: vec![1.0; STATE],
        command_weight: vec![1.0; COMMAND],
        command_lower: vec![-10.0; COMMAND],
        command_upper: vec![10.0; COMMAND],
        state_bounds: Vec::new(),
        equalities: Vec::new(),
        command_guess: vec![0.0; steps * COMMAND],
    }
}

/// `[A B]` of the lagged state, 27 × 30.
fn transition(dynamics: &LagModel) -> DMatrix<f64> {
    let mut jacobian = vec![0.0; FRESH * WIDTH];
    dynamics.jacobian(0, &[0.0; STATE], &[0.0; COMMAND], &mut jacobian);
    DMatrix::from_fn(STATE, WIDTH, |i, j| match i.checked_sub(FRESH) {
        None => jacobian[i * WIDTH + j],
        Some(lagged) => f64::from(lagged == j),
    })
}

/// `Q = CᵀPC + L_ww`, `P ← Q_zz − Q_zu Q_uu⁻¹ Q_uz` with nalgebra's products, nothing allocated in the loop.
struct NalgebraSweep {
    transition: DMatrix<f64>,
    transposed: DMatrix<f64>,
    value: DMatrix<f64>,
    product: DMatrix<f64>,
    quadratic: DMatrix<f64>,
    gains: DMatrix<f64>,
}

impl NalgebraSweep {
    fn new(transition: &DMatrix<f64>) -> Self {
        Self {
            transition: transition.clone(),
            transposed: transition.transpose(),
            value: DMatrix::zeros(STATE, STATE),
            product: DMatrix::zeros(STATE, WIDTH),
            quadratic: DMatrix::zeros(WIDTH, WIDTH),
            gains: DMatrix::zeros(COMMAND, STATE),
        }
    }

    fn run(&mut self) {
        self.value.fill(0.0);
        self.value.fill_diagonal(2.0);
        for _ in 1..KNOTS {
            self.product.gemm(1.0, &self.value, &self.transition, 0.0);
            self.quadratic.gemm(1.0, &self.transposed, &self.product, 0.0);
            for i in 0..WIDTH {
                self.quadratic[(i, i)] += 2.0;
            }
            let hessian: Matrix3<f64> = self.quadratic.fixed_view::<3, 3>(STATE, STATE).into_owned();
            let inverse = hessian.cholesky().expect("convex").inverse();
            let cross: SMatrix<f64, COMMAND, STATE> =
                self.quadratic.fixed_view::<COMMAND, STATE>(STATE, 0).into_owned();
            self.gains.copy_from(&(-inverse * cross));
            self.value
                .copy_from(&self.quadratic.fixed_view::<STATE, STATE>(0, 0));
            let to_command = self.quadratic.fixed_view::<STATE, COMMAND>(0, STATE);
            self.value.gemm(1.0, &to_command, &self.gains, 1.0);
        }
        black_box(&self.value);
    }
}

/// The same with faer's products.
struct FaerSweep {
    transition: Mat<f64>,
    value: Mat<f64>,
    product: Mat<f64>,
    quadratic: Mat<f64>,
    gains: Mat<f64>,
}

impl FaerSweep {
    fn new(transition: &DMatrix<f64>) -> Self {
        Self {
            transition: Mat::from_fn(STATE, WIDTH, |i, j| transition[(i, j)]),
            value: Mat::zeros(STATE, STATE),
            product: Mat::zeros(STATE, WIDTH),
            quadratic: Mat::zeros(WIDTH, WIDTH),
            gains: Mat::zeros(COMMAND, STATE),
        }
    }

    fn run(&mut self) {
        let Self {
            transition,
            value,
            product,
            quadratic,
            gains,
        } = self;
        value.fill(0.0);
        for i in 0..STATE {
            value[(i, i)] = 2.0;
        }
        for _ in 1..KNOTS {
            matmul(
                &mut *product,
                Accum::Replace,
                &*value,
                &*transition,
                1.0,
                Par::Seq,
            );
            let transposed = transition.transpose();
            matmul(
                &mut *quadratic,
                Accum::Replace,
                transposed,
                &*product,
                1.0,
                Par::Seq,
            );
            for i in 0..WIDTH {
                quadratic[(i, i)] += 2.0;
            }
            let hessian = Matrix3::from_fn(|i, j| quadratic[(STATE + i, STATE + j)]);
            let inverse = hessian.cholesky().expect("convex").inverse();
            for i in 0..STATE {
                for j in 0..COMMAND {
                    gains[(j, i)] = -(0..COMMAND)
                        .map(|l| inverse[(j, l)] * quadratic[(STATE + l, i)])
                        .sum::<f64>();
                }
            }
            value.copy_from(quadratic.submatrix(0, 0, STATE, STATE));
            let to_command = quadratic.submatrix(0, STATE, STATE, COMMAND);
            matmul(&mut *value, Accum::Add, to_command, &*gains, 1.0, Par::Seq);
        }
        black_box(&*value);
    }
}
