//! What one Riccati sweep costs: the solver's, which exploits the shift of a lagged model, against dense ones that do the
//! same work (Jacobians of every knot; gains, steps and costates; a value Hessian that stays symmetric), for N = 200
//! knots, 27 states, 3 commands; and how near it comes to the machine's speed on large matrices.
//!
//! ```text
//! cargo run --release -p flyvine --example riccati_sweep
//! ```
//!
//! Prints one JSON object; times are process-CPU µs, the minimum of interleaved rounds (the large product has its own).

#![allow(clippy::print_stdout)] // an example is a program

use faer::linalg::matmul::matmul;
use faer::prelude::ReborrowMut;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use flyvine::model::{CommandInputs, LagModel};
use flyvine::trajopt::{Dynamics, Options, Problem, Solver};
use nalgebra::{DMatrix, DMatrixView, Dyn, SMatrix, SVector};
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
    let mut dense =
        [nalgebra_product, faer_product].map(|product| DenseSweep::new(&transition(&dynamics), product));
    let large = Mat::<f64>::from_fn(LARGE, LARGE, |i, j| (i + 2 * j) as f64 / LARGE as f64);
    let mut product = Mat::<f64>::zeros(LARGE, LARGE);

    let mut fastest = [f64::INFINITY; 3];
    for _ in 0..ROUNDS {
        let times = [
            cpu_us(|| assert!(solver.sweep(), "the problem is convex")),
            cpu_us(|| dense[0].run()),
            cpu_us(|| dense[1].run()),
        ];
        for (fastest, time) in fastest.iter_mut().zip(times) {
            *fastest = fastest.min(time);
        }
    }
    // Not in between: it would empty the caches.
    let large = (0..ROUNDS)
        .map(|_| cpu_us(|| matmul(&mut product, Accum::Replace, &large, &large, 1.0, Par::Seq)))
        .fold(f64::INFINITY, f64::min);
    for dense in &dense {
        let error = dense.gain_error(&solver.solution().gains);
        assert!(error <= 1e-10, "the sweeps' gains differ by {error}");
    }

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

/// `product = P C` and `quadratic = Cᵀ product`, of P and C.
type Product = fn(&DMatrix<f64>, &DMatrix<f64>, &mut DMatrix<f64>, &mut DMatrix<f64>);

fn nalgebra_product(
    value: &DMatrix<f64>,
    transition: &DMatrix<f64>,
    product: &mut DMatrix<f64>,
    quadratic: &mut DMatrix<f64>,
) {
    product.gemm(1.0, value, transition, 0.0);
    // A transposed view: nothing is copied.
    let (rows, columns) = (Dyn(WIDTH), Dyn(STATE));
    let transposed = DMatrixView::from_slice_with_strides_generic(
        transition.as_slice(),
        rows,
        columns,
        Dyn(STATE),
        Dyn(1),
    );
    quadratic.gemm(1.0, &transposed, &*product, 0.0);
}

fn faer_product(
    value: &DMatrix<f64>,
    transition: &DMatrix<f64>,
    product: &mut DMatrix<f64>,
    quadratic: &mut DMatrix<f64>,
) {
    let value = MatRef::from_column_major_slice(value.as_slice(), STATE, STATE);
    let transition = MatRef::from_column_major_slice(transition.as_slice(), STATE, WIDTH);
    let mut product = MatMut::from_column_major_slice_mut(product.as_mut_slice(), STATE, WIDTH);
    let quadratic = MatMut::from_column_major_slice_mut(quadratic.as_mut_slice(), WIDTH, WIDTH);
    matmul(product.rb_mut(), Accum::Replace, value, transition, 1.0, Par::Seq);
    matmul(
        quadratic,
        Accum::Replace,
        transition.transpose(),
        product,
        1.0,
        Par::Seq,
    );
}

/// `Q = CᵀPC + L_ww`, `h = g + Cᵀ p`, `K = −Q_uu⁻¹ Q_uz`, `d = −Q_uu⁻¹ h_u`, `P ← Q_zz + Q_zu K`, `p ← h_z + Q_zu d`
/// with somebody's products; nothing is allocated in the loop.
struct DenseSweep {
    multiply: Product,
    /// C of every knot.
    transitions: Vec<DMatrix<f64>>,
    gains: Vec<SMatrix<f64, COMMAND, STATE>>,
    steps: Vec<SVector<f64, COMMAND>>,
    value: DMatrix<f64>,
    product: DMatrix<f64>,
    quadratic: DMatrix<f64>,
}

impl DenseSweep {
    fn new(transition: &DMatrix<f64>, multiply: Product) -> Self {
        Self {
            multiply,
            transitions: vec![transition.clone(); KNOTS - 1],
            gains: vec![SMatrix::zeros(); KNOTS - 1],
            steps: vec![SVector::zeros(); KNOTS - 1],
            value: DMatrix::zeros(STATE, STATE),
            product: DMatrix::zeros(STATE, WIDTH),
            quadratic: DMatrix::zeros(WIDTH, WIDTH),
        }
    }

    fn run(&mut self) {
        self.value.fill(0.0);
        self.value.fill_diagonal(2.0);
        let mut costate = SVector::<f64, STATE>::repeat(1e-3);
        for (knot, transition) in self.transitions.iter().enumerate().rev() {
            (self.multiply)(&self.value, transition, &mut self.product, &mut self.quadratic);
            for i in 0..WIDTH {
                self.quadratic[(i, i)] += 2.0;
            }
            let mut linear = SVector::<f64, WIDTH>::repeat(1e-3);
            linear.gemv_tr(1.0, transition, &costate, 1.0);
            let hessian = self
                .quadratic
                .fixed_view::<COMMAND, COMMAND>(STATE, STATE)
                .into_owned();
            let inverse = hessian.cholesky().expect("convex").inverse();
            let gains = &mut self.gains[knot];
            *gains = -inverse * self.quadratic.fixed_view::<COMMAND, STATE>(STATE, 0);
            let step = -inverse * linear.fixed_rows::<COMMAND>(STATE);
            let to_command = self.quadratic.fixed_view::<STATE, COMMAND>(0, STATE);
            costate = linear.fixed_rows::<STATE>(0) + to_command * step;
            self.steps[knot] = step;
            self.value
                .copy_from(&self.quadratic.fixed_view::<STATE, STATE>(0, 0));
            self.value.gemm(1.0, &to_command, &*gains, 1.0);
            // Else its antisymmetric part grows from knot to knot.
            self.value.fill_lower_triangle_with_upper_triangle();
        }
        black_box(&self.value);
    }

    /// The largest difference from the solver's gains.
    fn gain_error(&self, gains: &[f64]) -> f64 {
        let expected = gains
            .chunks_exact(COMMAND * STATE)
            .map(SMatrix::<f64, COMMAND, STATE>::from_row_slice);
        self.gains
            .iter()
            .zip(expected)
            .map(|(found, expected)| (found - expected).amax())
            .fold(0.0, f64::max)
    }
}
