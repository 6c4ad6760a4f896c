//! Solves the given problem files and prints a line each.
use flyvine::{benchmark, trajopt::Options};
fn main() {
    for path in std::env::args().skip(1) {
        let b = benchmark::read_problem(path.as_ref()).unwrap();
        let t = std::time::Instant::now();
        let r =
            benchmark::solve_report(&b, Options::default(), 20, &|| t.elapsed().as_secs_f64() * 1e3).unwrap();
        eprintln!(
            "{:14} {:20} J {:.7} viol {:.1e} stat {:.1e} it {} fact {} ms {:.3}",
            r.problem,
            r.status,
            r.cost,
            r.max_violation,
            r.stationarity,
            r.iterations,
            r.factorizations,
            r.solve_ms
        );
    }
}
