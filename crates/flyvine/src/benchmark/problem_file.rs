//! Reading a problem file.

use super::json::{BenchmarkError, Node};
use crate::model::{CommandInputs, HEIGHT_ROW, LagModel, QuadraticTerms, STATE_LEN, ScheduledModel};
use crate::trajopt::{Equality, Problem, StateBound};
use std::path::Path;

/// One problem of the benchmark set: cost and constraints, and the dynamics that they are subject to.
#[derive(Debug, Clone)]
pub struct BenchmarkProblem {
    /// The problem's name.
    pub name: String,
    /// Cost, constraints, initial guess.
    pub problem: Problem,
    /// Lagged models, mixed by the schedule.
    pub dynamics: ScheduledModel,
}

/// Reads and validates a problem file.
///
/// # Errors
/// [`BenchmarkError`], naming the key, what was found and what was expected.
pub fn read_problem(path: &Path) -> Result<BenchmarkProblem, BenchmarkError> {
    let text = std::fs::read_to_string(path).map_err(|source| BenchmarkError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    parse_problem(&text)
}

/// Parses and validates a problem. Keys that the format does not define are ignored: they describe.
///
/// # Errors
/// As [`read_problem`].
pub fn parse_problem(text: &str) -> Result<BenchmarkProblem, BenchmarkError> {
    let document = serde_json::from_str(text)?;
    let root = Node::root(&document);
    let name = root.get("name", "the problem's name")?;
    let name = name
        .value
        .as_str()
        .ok_or_else(|| name.unexpected("text"))?
        .to_string();

    let knots_node = root.get("N", "the number of knots")?;
    let knots = knots_node.count()?;
    if knots < 2 {
        return Err(knots_node.unexpected("at least 2 knots"));
    }
    let start = root.get("z0", "the initial state")?;
    let n = start.items()?.count();
    if n == 0 || n % STATE_LEN != 0 {
        return Err(start.unexpected("a list of 9 numbers per lag"));
    }
    let lower = root.get("umin", "the lower command bounds")?;
    let m = lower.items()?.count();
    if m != CommandInputs::Position.len() {
        return Err(lower.unexpected("a list of 3 numbers, one per entry of the commanded position"));
    }
    let vector = |key: &str, len: usize| root.get(key, &format!("{len} numbers"))?.vector(len);
    let matrix = |key: &str, rows: usize, columns: usize| {
        root.get(key, &format!("{rows} rows of {columns} numbers"))?
            .matrix(rows, columns)
    };
    let problem = Problem {
        knots,
        start: start.vector(n)?,
        state_reference: matrix("zref", knots, n)?,
        command_reference: matrix("uref", knots - 1, m)?,
        state_weight: vector("Q", n)?,
        command_weight: vector("R", m)?,
        command_lower: lower.vector(m)?,
        command_upper: vector("umax", m)?,
        state_bounds: parse_all(&root, "state_bounds", parse_state_bound)?,
        equalities: parse_all(&root, "equalities", parse_equality)?,
        command_guess: matrix("u_init", knots - 1, m)?,
    };
    let dynamics = parse_dynamics(&root, knots - 1, n, m)?;
    problem.validate(&dynamics)?;
    Ok(BenchmarkProblem {
        name,
        problem,
        dynamics,
    })
}

fn parse_all<T>(
    root: &Node<'_>,
    key: &str,
    parse: impl Fn(&Node<'_>) -> Result<T, BenchmarkError>,
) -> Result<Vec<T>, BenchmarkError> {
    root.get(key, "a list, possibly empty")?
        .items()?
        .map(|item| parse(&item))
        .collect()
}

fn parse_state_bound(node: &Node<'_>) -> Result<StateBound, BenchmarkError> {
    let side = |key: &str, none: f64| {
        let side = node.get(key, "a number, or null for none")?;
        if side.value.is_null() {
            Ok(none)
        } else {
            side.number()
        }
    };
    Ok(StateBound {
        first_knot: node.get("k0", "the first knot")?.count()?,
        last_knot: node.get("k1", "the last knot")?.count()?,
        index: node.get("idx", "a state entry")?.count()?,
        lower: side("lo", f64::NEG_INFINITY)?,
        upper: side("hi", f64::INFINITY)?,
        price: f64::INFINITY,
    })
}

fn parse_equality(node: &Node<'_>) -> Result<Equality, BenchmarkError> {
    Ok(Equality {
        knot: node.get("k", "a knot")?.count()?,
        index: node.get("idx", "a state entry")?.count()?,
        value: node.get("value", "a number")?.number()?,
        price: f64::INFINITY,
    })
}

fn parse_dynamics(
    root: &Node<'_>,
    steps: usize,
    n: usize,
    m: usize,
) -> Result<ScheduledModel, BenchmarkError> {
    let models_node = root.get("models", "a list of models")?;
    let mut models = Vec::new();
    for model in models_node.items()? {
        models.push(parse_model(&model, n, m)?);
    }
    let schedule = root.get("schedule", "null, or weights of the models at every step")?;
    let weights = match (schedule.value.is_null(), models.len()) {
        (true, 1) => vec![1.0],
        (true, _) => return Err(models_node.unexpected("one model where the schedule is null")),
        (false, 0) => return Err(models_node.unexpected("at least one model")),
        (false, count) => schedule.matrix(steps, count)?,
    };
    Ok(ScheduledModel::mixture(&models, &weights)?)
}

fn parse_model(node: &Node<'_>, n: usize, m: usize) -> Result<LagModel, BenchmarkError> {
    let width = n + m;
    let a = node.get("A", "9 rows")?.matrix(STATE_LEN, n)?;
    let b = node.get("B", "9 rows")?.matrix(STATE_LEN, m)?;
    let height = node.get("height", "a0, lin, quad")?;
    let mut linear = Vec::with_capacity(STATE_LEN * width);
    for row in 0..HEIGHT_ROW {
        linear.extend_from_slice(&a[row * n..][..n]);
        linear.extend_from_slice(&b[row * m..][..m]);
    }
    linear.extend(height.get("lin", "the linear coefficients")?.vector(width)?);
    let mut offset = vec![0.0; STATE_LEN];
    offset[HEIGHT_ROW] = height.get("a0", "the offset")?.number()?;
    let quadratic = height
        .get("quad", "the quadratic coefficients, upper triangle")?
        .matrix(width, width)?;
    let upper_triangle = (0..width)
        .flat_map(|i| quadratic[i * width + i..(i + 1) * width].to_vec())
        .collect();
    let terms = QuadraticTerms {
        row: HEIGHT_ROW,
        upper_triangle,
    };
    Ok(LagModel::new(
        n / STATE_LEN,
        CommandInputs::Position,
        offset,
        linear,
        &[terms],
    )?)
}
