//! The arm's shape along a flight of the built-in vehicle, for the replay.

use std::cell::RefCell;
use std::rc::Rc;

use flyvine::flight::Configuration;
use flyvine::link::{Observation, Setpoint, Vehicle, VehicleError};
use flyvine::run::ArmShapes;
use flyvine::sim::SimulatedVehicle;

/// The built-in vehicle, watched: motion capture sees only the arm's end, the simulation knows the rest.
pub struct WatchedVehicle {
    vehicle: SimulatedVehicle,
    shapes: ArmShapes,
}

impl WatchedVehicle {
    /// Watches `vehicle`.
    pub fn new(vehicle: SimulatedVehicle) -> Self {
        Self {
            vehicle,
            shapes: Vec::new(),
        }
    }

    /// The shapes of the first `rows` rows of the last flight.
    pub fn into_shapes(mut self, rows: usize) -> ArmShapes {
        self.shapes.truncate(rows);
        self.shapes
    }

    fn watch(&mut self) {
        self.shapes.push(nodes_to_draw(&self.vehicle));
    }
}

impl Vehicle for WatchedVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        let observation = self.vehicle.reset(configuration, seed)?;
        self.shapes.clear();
        self.watch();
        Ok(observation)
    }

    fn step(
        &mut self,
        setpoint: Setpoint,
        configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        let observation = self.vehicle.step(setpoint, configuration)?;
        self.watch();
        Ok(observation)
    }
}

/// The arm's newest nodes, quadrotor end first, m; empty where the vehicle does not know them.
#[derive(Clone, Default)]
pub struct ArmNodes(Rc<RefCell<Vec<[f64; 3]>>>);

impl ArmNodes {
    /// The nodes, where the vehicle knows them.
    pub fn newest(&self) -> Option<Vec<[f64; 3]>> {
        let nodes = self.0.borrow();
        (!nodes.is_empty()).then(|| nodes.clone())
    }
}

/// The built-in vehicle with its arm on show, for the live page.
pub struct ShownVehicle {
    vehicle: SimulatedVehicle,
    arm: ArmNodes,
}

impl ShownVehicle {
    /// Shows the arm of `vehicle` in `arm`.
    pub fn new(vehicle: SimulatedVehicle, arm: ArmNodes) -> Self {
        Self { vehicle, arm }
    }

    fn show(&self) {
        *self.arm.0.borrow_mut() = nodes_to_draw(&self.vehicle);
    }
}

impl Vehicle for ShownVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        let observation = self.vehicle.reset(configuration, seed)?;
        self.show();
        Ok(observation)
    }

    fn step(
        &mut self,
        setpoint: Setpoint,
        configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        let observation = self.vehicle.step(setpoint, configuration)?;
        self.show();
        Ok(observation)
    }
}

/// Nodes to 0.1 mm: what a replay shows.
fn nodes_to_draw(vehicle: &SimulatedVehicle) -> Vec<[f64; 3]> {
    let tenths = |value: f64| (value * 1e4).round() / 1e4;
    let nodes = vehicle.truth().nodes;
    nodes.into_iter().map(|node| node.map(tenths)).collect()
}
