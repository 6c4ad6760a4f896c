//! The arm's shape along a flight of the built-in vehicle, for the replay.

use flyvine::flight::Configuration;
use flyvine::link::{Observation, Vehicle, VehicleError};
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

    /// Nodes to 0.1 mm: what the replay shows.
    fn watch(&mut self) {
        let tenths = |value: f64| (value * 1e4).round() / 1e4;
        let nodes = self.vehicle.truth().nodes;
        self.shapes
            .push(nodes.into_iter().map(|node| node.map(tenths)).collect());
    }
}

impl Vehicle for WatchedVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        let observation = self.vehicle.reset(configuration, seed)?;
        self.shapes.clear();
        self.watch();
        Ok(observation)
    }

    fn step(&mut self, command: [f64; 3], configuration: Configuration) -> Result<Observation, VehicleError> {
        let observation = self.vehicle.step(command, configuration)?;
        self.watch();
        Ok(observation)
    }
}
