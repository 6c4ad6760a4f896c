use super::*;
use crate::trajopt::Dynamics;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A model with random coefficients and quadratic terms in `quadratic_rows`.
pub(crate) fn random_model(
    lags: usize,
    inputs: CommandInputs,
    quadratic_rows: &[usize],
    seed: u64,
) -> LagModel {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = |count: usize| {
        (0..count)
            .map(|_| random.random_range(-1.0..1.0))
            .collect::<Vec<f64>>()
    };
    let p = lags * STATE_LEN + inputs.len();
    let (offset, linear) = (draw(STATE_LEN), draw(STATE_LEN * p));
    let quadratic: Vec<QuadraticTerms> = quadratic_rows
        .iter()
        .map(|&row| QuadraticTerms {
            row,
            upper_triangle: draw(p * (p + 1) / 2),
        })
        .collect();
    LagModel::new(lags, inputs, offset, linear, &quadratic).unwrap()
}

fn random_point(model: &LagModel, seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = |count: usize| (0..count).map(|_| random.random_range(-1.0..1.0)).collect();
    (draw(model.state_len()), draw(model.command_len()))
}

#[test]
fn step_is_the_polynomial() {
    let model = random_model(3, CommandInputs::Position, &[HEIGHT_ROW], 1);
    let (z, u) = random_point(&model, 2);
    let w = [z.clone(), u.clone()].concat();
    let mut fresh = [0.0; STATE_LEN];
    model.step(0, &z, &u, &mut fresh);
    let terms = &model.quadratic()[0].upper_triangle;
    let pairs = (0..30).flat_map(|i| (i..30).map(move |j| (i, j)));
    let products: f64 = pairs.zip(terms).map(|((i, j), a)| a * w[i] * w[j]).sum();
    for row in 0..STATE_LEN {
        let linear: f64 = w
            .iter()
            .zip(&model.linear()[row * 30..])
            .map(|(w, l)| w * l)
            .sum();
        let expected = model.offset()[row] + linear + if row == HEIGHT_ROW { products } else { 0.0 };
        assert!(
            (fresh[row] - expected).abs() < 1e-12,
            "row {row}: {} against {expected}",
            fresh[row]
        );
    }
    assert_eq!(
        terms.len() + 30 + 1,
        496,
        "coefficients of the paper's height row"
    );
}

#[test]
fn jacobian_and_curvature_agree_with_finite_differences() {
    for (lags, inputs, rows) in [
        (3, CommandInputs::Position, vec![HEIGHT_ROW]),
        (5, CommandInputs::PositionAndVelocity, vec![0, 6, HEIGHT_ROW]),
        (1, CommandInputs::Position, vec![]),
    ] {
        let model = random_model(lags, inputs, &rows, 3);
        let (z, u) = random_point(&model, 4);
        let (n, p) = (model.state_len(), model.regressor_len());
        let adjoint: Vec<f64> = (0..STATE_LEN).map(|i| 0.3 * i as f64 - 1.0).collect();
        let mut jacobian = vec![0.0; STATE_LEN * p];
        model.jacobian(0, &z, &u, &mut jacobian);
        let stride = kernel::padded(p);
        let mut curvature = vec![0.0; p * stride];
        model.add_curvature(0, &z, &u, &adjoint, stride, &mut curvature);
        // Polynomials of degree two: central differences are exact but for rounding.
        let h = 1e-3;
        let at = |column: usize, delta: f64| {
            let mut w = [z.clone(), u.clone()].concat();
            w[column] += delta;
            let (mut fresh, mut jacobian) = (vec![0.0; STATE_LEN], vec![0.0; STATE_LEN * p]);
            model.step(0, &w[..n], &w[n..], &mut fresh);
            model.jacobian(0, &w[..n], &w[n..], &mut jacobian);
            (fresh, jacobian)
        };
        for column in 0..p {
            let ((plus, jacobian_plus), (minus, jacobian_minus)) = (at(column, h), at(column, -h));
            for row in 0..STATE_LEN {
                let difference = (plus[row] - minus[row]) / (2.0 * h);
                let exact = jacobian[row * p + column];
                assert!(
                    (difference - exact).abs() < 1e-6 * exact.abs().max(1.0),
                    "row {row}, {column}"
                );
            }
            for other in 0..p {
                let along = |jacobian: &[f64]| -> f64 {
                    (0..STATE_LEN)
                        .map(|row| adjoint[row] * jacobian[row * p + other])
                        .sum()
                };
                let difference = (along(&jacobian_plus) - along(&jacobian_minus)) / (2.0 * h);
                let exact = curvature[column * stride + other];
                assert!(
                    (difference - exact).abs() < 1e-6 * exact.abs().max(1.0),
                    "{column}, {other}"
                );
            }
        }
    }
}

#[test]
fn json_keeps_every_bit() {
    let model = random_model(3, CommandInputs::Position, &[HEIGHT_ROW], 5);
    let text = serde_json::to_string(&model).unwrap();
    assert_eq!(serde_json::from_str::<LagModel>(&text).unwrap(), model);
}

#[test]
fn wrong_shapes_and_values_are_named() {
    let message = |offset: usize, linear: usize, terms: usize, value: f64| {
        let quadratic = QuadraticTerms {
            row: HEIGHT_ROW,
            upper_triangle: vec![0.0; terms],
        };
        LagModel::new(
            3,
            CommandInputs::Position,
            vec![value; offset],
            vec![0.0; linear],
            &[quadratic],
        )
        .unwrap_err()
        .to_string()
    };
    assert!(message(8, 270, 465, 0.0).contains("offset: found 8 values, expected 9"));
    assert!(message(9, 269, 465, 0.0).contains("found 269 values, expected 270"));
    assert!(message(9, 270, 464, 0.0).contains("row 8: found 464 values, expected 465"));
    assert!(message(9, 270, 465, f64::NAN).contains("offset: value 0 is not a finite number"));
    let lags = LagModel::new(0, CommandInputs::Position, vec![], vec![], &[]).unwrap_err();
    assert!(lags.to_string().contains("lags: found 0, expected 1 to 12"));
    let terms = QuadraticTerms {
        row: 8,
        upper_triangle: vec![0.0; 465],
    };
    let twice = [terms.clone(), terms];
    let duplicate = LagModel::new(3, CommandInputs::Position, vec![0.0; 9], vec![0.0; 270], &twice);
    assert!(duplicate.unwrap_err().to_string().contains("at most once"));
}
