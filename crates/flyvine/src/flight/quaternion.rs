//! Hamilton quaternions `[w, x, y, z]`, `world_from_body`, as recordings hold them.

/// Largest distance of a recorded quaternion's norm from 1 that is taken for rounding.
const NORM_TOLERANCE: f64 = 1e-2;

/// The inner product of two quaternions; negative where they are on opposite hemispheres.
pub fn dot(p: [f64; 4], q: [f64; 4]) -> f64 {
    (0..4).map(|i| p[i] * q[i]).sum()
}

/// `q` or `−q` (the same rotation), whichever is nearer to `reference`.
pub fn align(reference: [f64; 4], q: [f64; 4]) -> [f64; 4] {
    if dot(reference, q) < 0.0 { q.map(|c| -c) } else { q }
}

/// `q` scaled to unit length, or its norm if that is too far from 1 to be rounding.
///
/// What is already unit to machine precision is returned as it is, so that reading what was written
/// changes nothing.
pub fn unit(q: [f64; 4]) -> Result<[f64; 4], f64> {
    let norm = dot(q, q).sqrt();
    if (norm - 1.0).abs() <= 8.0 * f64::EPSILON {
        Ok(q)
    } else if (norm - 1.0).abs() <= NORM_TOLERANCE {
        Ok(q.map(|c| c / norm))
    } else {
        Err(norm)
    }
}

/// The Hamilton product `p q`.
pub fn product(p: [f64; 4], q: [f64; 4]) -> [f64; 4] {
    let ([pw, px, py, pz], [qw, qx, qy, qz]) = (p, q);
    [
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    ]
}

/// Spherical linear interpolation from `p` (`s = 0`) to `q` (`s = 1`) along the shorter arc, both unit.
pub fn slerp(p: [f64; 4], q: [f64; 4], s: f64) -> [f64; 4] {
    let q = align(p, q);
    // Half the angle between them, from the chord: accurate where they nearly coincide.
    let chord = (0..4).map(|i| (q[i] - p[i]).powi(2)).sum::<f64>().sqrt();
    let angle = 2.0 * (0.5 * chord).min(1.0).asin();
    let (a, b) = if angle < 1e-8 {
        (1.0 - s, s)
    } else {
        (
            ((1.0 - s) * angle).sin() / angle.sin(),
            (s * angle).sin() / angle.sin(),
        )
    };
    let mixed: [f64; 4] = std::array::from_fn(|i| a * p[i] + b * q[i]);
    let norm = dot(mixed, mixed).sqrt();
    mixed.map(|c| c / norm)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about_x(angle: f64) -> [f64; 4] {
        [(0.5 * angle).cos(), (0.5 * angle).sin(), 0.0, 0.0]
    }

    #[test]
    fn slerp_turns_at_a_constant_rate_along_the_shorter_arc() {
        for target in [1e-9, 1e-3, 1.0, 3.0] {
            for q in [about_x(target), about_x(target).map(|c| -c)] {
                let third = slerp(about_x(0.0), q, 1.0 / 3.0);
                assert!((dot(third, about_x(target / 3.0)).abs() - 1.0).abs() < 1e-14);
                assert!((third[1] - (target / 6.0).sin()).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn product_adds_angles_about_one_axis() {
        let sum = product(about_x(0.3), about_x(0.4));
        assert!((dot(sum, about_x(0.7)) - 1.0).abs() < 1e-15);
        // i j = k
        assert_eq!(
            product([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]),
            [0.0, 0.0, 0.0, 1.0]
        );
    }

    #[test]
    fn unit_is_idempotent_and_refuses_what_is_no_rotation() {
        let q = unit([0.7, 0.1, -0.5, 0.5]).unwrap();
        assert_eq!(unit(q), Ok(q));
        assert!(unit([0.0; 4]).is_err());
        assert!(unit([1.0, 0.2, 0.0, 0.0]).is_err());
    }
}
