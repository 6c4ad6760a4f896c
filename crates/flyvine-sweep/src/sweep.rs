//! The rows of a sweep: numbered, addressed by content, computed one by one.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

use flyvine::control::mpc::MpcOptions;
use flyvine::control::supervisor::Limits;
use flyvine::control::{ControlLaw, FlightOutcome, Flying, FlyingError, Trajectory, controller, fly_plan};
use flyvine::file::sha256_hex;
use flyvine::link::Vehicle;
use flyvine::model::Bank;
use flyvine::run::read_vehicle_file;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{Plan, PlanOptions, Task, make_plan, read_plan, write_plan};
use serde::{Deserialize, Serialize};

use super::parameters::ParameterTree;
use super::row::RowResult;
use super::{Success, SweepError, SweepFile};

/// Part of every key: rows of another version are other rows.
const ENGINE: &str = concat!("flyvine ", env!("CARGO_PKG_VERSION"), " rows 1");

/// More rows than this have a mistake in their grid.
const MAX_ROWS: f64 = 1e8;

/// A sweep with everything that its rows need: it can be sent to another machine as JSON.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct Sweep {
    parts: Parts,
    /// SHA-256 of every plan's JSON.
    plan_hashes: Vec<String>,
    tree: ParameterTree,
}

/// What makes a sweep.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Parts {
    file: SweepFile,
    plans: Vec<Plan>,
    vehicle: VehicleParameters,
    limits: Limits,
}

/// What is flown in one row.
#[derive(Debug, Clone, PartialEq)]
pub struct Row<'a> {
    /// Position in the sweep, from 0.
    pub index: usize,
    /// The plan.
    pub plan: &'a Plan,
    /// SHA-256 of the plan's JSON.
    pub plan_sha256: &'a str,
    /// The control law.
    pub law: ControlLaw,
    /// The seed.
    pub seed: u64,
    /// Values of [`Sweep::parameters`].
    pub values: Vec<f64>,
}

/// Everything that determines a row's result.
#[derive(Serialize)]
struct Identity<'a> {
    engine: &'static str,
    plan_sha256: &'a str,
    law: ControlLaw,
    mpc: Option<&'a MpcOptions>,
    vehicle: Option<&'a VehicleParameters>,
    /// Where there is no such vehicle: what it should have been.
    values: Option<&'a [f64]>,
    limits: &'a Limits,
    seed: u64,
}

impl From<Sweep> for Parts {
    fn from(sweep: Sweep) -> Self {
        sweep.parts
    }
}

impl TryFrom<Parts> for Sweep {
    type Error = SweepError;

    fn try_from(parts: Parts) -> Result<Self, SweepError> {
        let hash = |plan| Ok(sha256_hex(&serde_json::to_vec(plan).map_err(json("plan"))?));
        let sweep = Self {
            plan_hashes: parts.plans.iter().map(hash).collect::<Result<_, SweepError>>()?,
            tree: ParameterTree::new(&parts.vehicle).map_err(json("vehicle"))?,
            parts,
        };
        sweep.validate()?;
        Ok(sweep)
    }
}

fn json(what: &'static str) -> impl Fn(serde_json::Error) -> SweepError {
    move |source| SweepError::Json { what, source }
}

impl Sweep {
    /// Reads a sweep's file and everything that it names. Its tasks are planned; the plans are kept in `plans_folder`,
    /// and taken from there the next time. `planning` is told the name of every task that is planned.
    ///
    /// # Errors
    /// A file that cannot be read, a task that cannot be planned, or as [`Self::new`].
    pub fn read(
        path: &Path,
        plans_folder: &Path,
        planning: &mut dyn FnMut(&str),
    ) -> Result<Self, SweepError> {
        let file = SweepFile::read(path)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        let (vehicle, limits) = match &file.vehicle {
            Some(vehicle) => read_vehicle_file(&folder.join(vehicle))?,
            None => (VehicleParameters::default(), Limits::default()),
        };
        let mut plans = Vec::new();
        for plan in &file.plans {
            plans.push(read_plan(&folder.join(plan))?);
        }
        if let (Some(bank), false) = (&file.bank, file.tasks.is_empty()) {
            let bank_path = folder.join(bank);
            let bank_sha256 = hash_file(&bank_path)?;
            let bank = Bank::read(&bank_path)?;
            for task in &file.tasks {
                let task_path = folder.join(task);
                let task_sha256 = hash_file(&task_path)?;
                let task = Task::read(&task_path)?;
                let options = PlanOptions {
                    task_sha256,
                    bank_sha256: bank_sha256.clone(),
                    ..PlanOptions::default()
                };
                let determined_by = format!("{ENGINE} {} {}", options.task_sha256, options.bank_sha256);
                let kept = plans_folder.join(format!("{}.json", sha256_hex(determined_by.as_bytes())));
                if !kept.exists() {
                    planning(&task.name);
                    write_plan(&kept, &make_plan(&task, &bank, &options)?)?;
                }
                plans.push(read_plan(&kept)?);
            }
        }
        Self::new(file, plans, vehicle, limits)
    }

    /// A sweep of `plans` about `vehicle`, flown within `limits`; `file` says what is varied.
    ///
    /// # Errors
    /// Nothing to fly, a parameter that the vehicle does not have, a value that it cannot take, a spread that is no
    /// distribution, a plan that cannot be flown with one of the control laws.
    pub fn new(
        file: SweepFile,
        plans: Vec<Plan>,
        vehicle: VehicleParameters,
        limits: Limits,
    ) -> Result<Self, SweepError> {
        Self::try_from(Parts {
            file,
            plans,
            vehicle,
            limits,
        })
    }

    fn validate(&self) -> Result<(), SweepError> {
        let file = &self.parts.file;
        let wrong = |field: &str, found: String, expected: &str| {
            Err(SweepError::Field {
                sweep: file.name.clone(),
                field: field.to_owned(),
                found,
                expected: expected.to_owned(),
            })
        };
        if !file.tasks.is_empty() && file.bank.is_none() {
            return wrong("bank", "none".into(), "the bank that the tasks are planned on");
        }
        if self.parts.plans.is_empty() {
            return wrong(
                "plans, tasks",
                "none".into(),
                "at least one plan, or a task with a bank",
            );
        }
        if file.controllers.is_empty() {
            return wrong("controllers", "none".into(), "at least one control law");
        }
        let last_seed = file.first_seed.saturating_add(file.seeds);
        if file.seeds == 0 || i64::try_from(last_seed).is_err() {
            return wrong("seeds", file.seeds.to_string(), "at least 1, within 63 bits");
        }
        let sizes = (file.grid.values().map(|values| values.len() as f64)).product::<f64>();
        let rows = sizes * file.seeds as f64 * (self.parts.plans.len() * file.controllers.len()) as f64;
        if rows > MAX_ROWS {
            return wrong(
                "rows",
                format!("{rows:e}"),
                "at most 1e8; cut the sweep in pieces",
            );
        }
        let mut names = BTreeMap::new();
        for path in file.grid.keys().chain(file.spread.keys()) {
            if let Some(other) = names.insert(column_name(path), path) {
                let what = format!("`{other}` and `{path}`");
                return wrong(
                    "grid, spread",
                    what,
                    "parameters of different names, each in one of them",
                );
            }
            if self.tree.get(path).is_none() {
                let expected = "the path of a number in the vehicle's TOML, as `wind.mean_m_s.0`";
                return wrong("grid, spread", format!("`{path}`"), expected);
            }
        }
        for (path, values) in &file.grid {
            if values.is_empty() {
                return wrong(&format!("grid, `{path}`"), "no values".into(), "at least one");
            }
            for &value in values {
                let mut tree = self.tree.clone();
                tree.set(path, value);
                if let Err(why) = tree.vehicle() {
                    return wrong(&format!("grid, `{path}`"), value.to_string(), &why);
                }
            }
        }
        for (path, spread) in &file.spread {
            if let Some(expected) = spread.fault(self.tree.get(path).unwrap_or(0.0)) {
                return wrong(&format!("spread, `{path}`"), format!("{spread:?}"), expected);
            }
        }
        for plan in &self.parts.plans {
            for &law in &file.controllers {
                self.check_flyable(plan, law)
                    .map_err(|source| SweepError::Flying {
                        sweep: file.name.clone(),
                        plan: plan.task.name.clone(),
                        controller: law.name(),
                        source: Box::new(source),
                    })?;
            }
        }
        Ok(())
    }

    fn check_flyable(&self, plan: &Plan, law: ControlLaw) -> Result<(), FlyingError> {
        let trajectory = Trajectory::of_plan(plan)?;
        let model = plan.model()?;
        controller(plan, &trajectory, &model, &self.flying(law), &self.parts.limits).map(|_| ())
    }

    fn flying(&self, law: ControlLaw) -> Flying {
        Flying {
            law,
            mpc: self.parts.file.mpc.clone(),
            ..Flying::default()
        }
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.parts.file.name
    }

    /// What counts as a success.
    pub fn success(&self) -> &Success {
        &self.parts.file.success
    }

    /// Paths of the parameters that are varied: the grid's, then the spreads'.
    pub fn parameters(&self) -> Vec<&str> {
        let file = &self.parts.file;
        (file.grid.keys().chain(file.spread.keys()))
            .map(String::as_str)
            .collect()
    }

    /// The values of the grid.
    pub fn grid(&self) -> &BTreeMap<String, Vec<f64>> {
        &self.parts.file.grid
    }

    /// Combinations of the grid.
    fn cells(&self) -> usize {
        self.grid().values().map(Vec::len).product()
    }

    /// Number of rows: plans × control laws × combinations of the grid × seeds.
    pub fn rows(&self) -> usize {
        let file = &self.parts.file;
        self.parts.plans.len() * file.controllers.len() * self.cells() * file.seeds as usize
    }

    /// Row `index` < [`Self::rows`]. Seeds vary fastest, then the grid (its last parameter first), the control law and
    /// the plan.
    pub fn row(&self, index: usize) -> Row<'_> {
        let file = &self.parts.file;
        let mut rest = index;
        let mut digit = |base: usize| {
            let digit = rest % base;
            rest /= base;
            digit
        };
        let seed = file.first_seed + digit(file.seeds as usize) as u64;
        let mut values: Vec<f64> = self
            .grid()
            .values()
            .rev()
            .map(|values| values[digit(values.len())])
            .collect();
        values.reverse();
        values.extend(
            file.spread
                .iter()
                .map(|(path, spread)| spread.draw(path, self.tree.get(path).unwrap_or(0.0), seed)),
        );
        let law = file.controllers[digit(file.controllers.len())];
        let plan = digit(self.parts.plans.len());
        Row {
            index,
            plan: &self.parts.plans[plan],
            plan_sha256: &self.plan_hashes[plan],
            law,
            seed,
            values,
        }
    }

    fn parameters_of(&self, row: &Row) -> Result<VehicleParameters, String> {
        let mut tree = self.tree.clone();
        for (path, value) in self.parameters().into_iter().zip(&row.values) {
            tree.set(path, *value);
        }
        tree.vehicle()
    }

    /// Hash of everything that determines row `index`: lower-case hexadecimal SHA-256.
    pub fn key(&self, index: usize) -> String {
        let row = self.row(index);
        let vehicle = self.parameters_of(&row).ok();
        let identity = Identity {
            engine: ENGINE,
            plan_sha256: row.plan_sha256,
            law: row.law,
            mpc: (row.law == ControlLaw::Mpc).then_some(&self.parts.file.mpc),
            values: vehicle.is_none().then_some(&row.values),
            vehicle: vehicle.as_ref(),
            limits: &self.parts.limits,
            seed: row.seed,
        };
        // Numbers, strings and lists of them always have a JSON.
        sha256_hex(&serde_json::to_vec(&identity).unwrap_or_default())
    }

    /// Flies row `index` and judges it.
    pub fn compute(&self, index: usize) -> RowResult {
        let flown = self
            .vehicle(index)
            .and_then(|mut vehicle| self.fly(index, &mut vehicle));
        match flown {
            Ok(outcome) => RowResult::of(self.row(index).plan, outcome),
            Err(cause) => RowResult::refused(cause),
        }
    }

    /// The vehicle of row `index`.
    ///
    /// # Errors
    /// Why there is no such vehicle, in words.
    pub fn vehicle(&self, index: usize) -> Result<SimulatedVehicle, String> {
        let parameters = self.parameters_of(&self.row(index))?;
        SimulatedVehicle::new(parameters).map_err(|error| error.to_string())
    }

    /// Flies row `index` on `vehicle`, which is [`Self::vehicle`] or watches it.
    ///
    /// # Errors
    /// Why nothing was flown, in words.
    pub fn fly(&self, index: usize, vehicle: &mut dyn Vehicle) -> Result<FlightOutcome, String> {
        let row = self.row(index);
        fly_plan(
            row.plan,
            &self.flying(row.law),
            self.parts.limits,
            vehicle,
            row.seed,
            &mut |_, _| ControlFlow::Continue(()),
        )
        .map_err(|error| error.to_string())
    }

    /// The row whose key begins with `prefix`.
    ///
    /// # Errors
    /// None does, or several do.
    pub fn find(&self, prefix: &str) -> Result<usize, SweepError> {
        let found: Vec<usize> = (0..self.rows())
            .filter(|&index| self.key(index).starts_with(prefix))
            .collect();
        match found[..] {
            [index] => Ok(index),
            _ => Err(SweepError::Key {
                key: prefix.to_owned(),
                found: found.len(),
            }),
        }
    }
}

/// A parameter's column in the table: `wind.mean_m_s.0` → `wind_mean_m_s_0`, which SQL need not quote.
pub(crate) fn column_name(path: &str) -> String {
    path.replace('.', "_")
}

fn hash_file(path: &Path) -> Result<String, SweepError> {
    Ok(sha256_hex(&std::fs::read(path).map_err(SweepError::file(path))?))
}
