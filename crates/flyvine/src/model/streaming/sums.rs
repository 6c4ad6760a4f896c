//! What a fit needs to know of the rows of some flights, in one of two forms.

use super::super::family::rest_state;
use super::super::features::{Coordinates, quadratic_len, quadratic_terms};
use super::super::lag::STATE_LEN;
use super::super::least_squares::{Solution, TriangularFactor};
use super::super::options::Structure;
use super::super::shape::{Ridges, Row, Shape};
use super::super::track::Track;
use super::moments::Moments;
use super::pairwise::Merge;
use crate::HOVER_HEIGHT_M;
use crate::flight::Configuration;
use faer::Mat;
use serde::{Deserialize, Serialize};

/// Rows that are factored together.
const FACTORED_ROWS: usize = 4096;

/// How rows are reduced to what a fit needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reduction {
    /// Sums of products of columns (normal equations). Loses digits where columns are nearly dependent, and says so.
    #[default]
    Moments,
    /// Triangular factors (TSQR): several times slower, whatever the columns.
    Orthogonal,
}

/// The rows of some flights at one configuration, reduced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Sums {
    Moments(Moments),
    Triangles {
        /// Of `[w | y]`, all nine signals' increments y.
        linear: Triangle,
        /// Of `[1, d, d dᵀ | y_height]`, if that row is quadratic.
        height: Option<Triangle>,
    },
}

/// A [`TriangularFactor`], to keep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Triangle {
    rows: usize,
    regressors: usize,
    width: usize,
    /// Column-major.
    columns: Vec<f64>,
}

/// Regressors of one configuration: e = (1, d), d = T (w − w_rest) being the motion about rest in the coordinates of
/// [`Coordinates`]. About rest the products are small where they do not matter; about the room's origin their condition
/// number is hundreds of times larger.
pub(crate) struct Basis {
    shape: Shape,
    coordinates: Coordinates,
    /// w at rest.
    rest: Vec<f64>,
}

impl Basis {
    pub fn new(shape: Shape, configuration: Configuration) -> Self {
        let mut rest = rest_state(configuration, shape.lags);
        rest.extend([0.0, 0.0, HOVER_HEIGHT_M]);
        rest.resize(shape.regressors(), 0.0);
        Self {
            shape,
            coordinates: Coordinates::new(shape.lags, shape.inputs),
            rest,
        }
    }

    /// Writes d.
    fn motion(&self, w: &[f64], d: &mut [f64]) {
        let about_rest: Vec<f64> = w.iter().zip(&self.rest).map(|(w, rest)| w - rest).collect();
        self.coordinates.apply(&about_rest, d);
    }

    /// M in `w = M e`.
    fn regressors_from_motion(&self) -> Mat<f64> {
        let rest = Mat::from_fn(self.rest.len(), 1, |i, _| self.rest[i]);
        faer::concat![[rest, self.coordinates.inverse()]]
    }

    /// The height row in w, from its coefficients on 1, d and the products of d.
    fn height_row(&self, theta: &[f64]) -> Row {
        let p = self.rest.len();
        let (linear, quadratic) = (&theta[1..=p], &theta[1 + p..]);
        let mut rest = vec![0.0; p];
        self.coordinates.apply(&self.rest, &mut rest);
        // Σ a_ij (v_i − s_i)(v_j − s_j), s being T w_rest.
        let mut on_v = linear.to_vec();
        let mut offset = theta[0];
        let mut next = quadratic.iter();
        for i in 0..p {
            offset -= linear[i] * rest[i];
            for (j, a) in (i..p).zip(&mut next) {
                on_v[i] -= a * rest[j];
                on_v[j] -= a * rest[i];
                offset += a * rest[i] * rest[j];
            }
        }
        Row {
            offset,
            linear: self.coordinates.linear_on_w(&on_v),
            upper_triangle: Some(self.coordinates.quadratic_on_w(quadratic)),
        }
    }
}

/// The two regressions of a configuration, solved.
pub(crate) struct Solved {
    pub linear: Solution,
    pub height: Option<Solution>,
}

impl Solved {
    /// The largest share by which a residual may exceed the least one.
    pub fn excess(&self) -> f64 {
        self.height
            .as_ref()
            .map_or(self.linear.excess, |height| height.excess.max(self.linear.excess))
    }

    /// The height row in w, if it is quadratic.
    pub fn height_row(&self, basis: &Basis) -> Option<Row> {
        self.height
            .as_ref()
            .map(|height| basis.height_row(height.theta.col_as_slice(0)))
    }
}

impl Sums {
    /// Reduces the transitions of one flight.
    pub fn of_track(track: &Track, basis: &Basis, reduction: Reduction) -> Self {
        let lags = basis.shape.lags;
        let transitions: Vec<usize> = (0..track.rows())
            .filter(|&k| track.unbroken(k, lags, 1))
            .collect();
        match reduction {
            Reduction::Moments => moments(track, &transitions, basis),
            Reduction::Orthogonal => transitions
                .chunks(FACTORED_ROWS)
                .map(|rows| triangles(track, rows, basis))
                .reduce(Merge::merge)
                .unwrap_or_else(|| triangles(track, &[], basis)),
        }
    }

    /// Rows reduced.
    pub fn rows(&self) -> usize {
        match self {
            Self::Moments(moments) => moments.rows,
            Self::Triangles { linear, .. } => linear.rows,
        }
    }

    /// Solves both regressions; `None` if the sums do not determine them.
    pub fn solve(&self, basis: &Basis, ridges: Ridges) -> Option<Solved> {
        let linear = ridges.linear_penalty(basis.shape);
        let penalty = ridges.height_penalty(basis.shape);
        match self {
            Self::Moments(moments) => {
                let gram = moments.linear_gram(basis.regressors_from_motion().as_ref());
                let height = match (moments.height_gram(), penalty) {
                    (Some(gram), Some(penalty)) => Some(gram.solution(&penalty)?),
                    _ => None,
                };
                Some(Solved {
                    linear: gram.solution(&linear)?,
                    height,
                })
            }
            Self::Triangles {
                linear: rows,
                height: products,
            } => {
                let height = match (products, penalty) {
                    (Some(triangle), Some(penalty)) => Some(triangle.factor().solution(&penalty)?),
                    _ => None,
                };
                Some(Solved {
                    linear: rows.factor().solution(&linear)?,
                    height,
                })
            }
        }
    }

    /// Whether these are sums as `shape` and `reduction` make them.
    pub fn fits(&self, shape: Shape, reduction: Reduction) -> bool {
        let p = shape.regressors();
        let quadratic = shape.structure == Structure::Paper;
        match self {
            Self::Moments(moments) => reduction == Reduction::Moments && moments.fits(1 + p, quadratic),
            Self::Triangles { linear, height } => {
                let is = |triangle: &Triangle, regressors: usize, targets: usize| {
                    (triangle.regressors, triangle.width) == (regressors, regressors + targets)
                        && triangle.columns.len().is_multiple_of(triangle.width)
                        && triangle.columns.len() / triangle.width <= triangle.rows
                        && triangle.columns.iter().all(|entry| entry.is_finite())
                };
                reduction == Reduction::Orthogonal
                    && is(linear, p, STATE_LEN)
                    && height.is_some() == quadratic
                    && height
                        .as_ref()
                        .is_none_or(|height| is(height, quadratic_len(p), 1))
            }
        }
    }
}

impl Merge for Sums {
    fn merge(self, later: Self) -> Self {
        match (self, later) {
            (Self::Moments(earlier), Self::Moments(later)) => Self::Moments(earlier.merge(later)),
            (
                Self::Triangles { linear, height },
                Self::Triangles {
                    linear: later_linear,
                    height: later_height,
                },
            ) => Self::Triangles {
                linear: linear.merge(&later_linear),
                height: height
                    .zip(later_height)
                    .map(|(height, later)| height.merge(&later)),
            },
            _ => unreachable!("a fit reduces all its rows alike"),
        }
    }
}

impl Triangle {
    fn keep(factor: &TriangularFactor) -> Self {
        let regressors = factor.regressors();
        let (width, columns) = factor.columns();
        Self {
            rows: factor.rows,
            regressors,
            width,
            columns,
        }
    }

    fn factor(&self) -> TriangularFactor {
        TriangularFactor::from_columns(self.rows, self.regressors, self.width, &self.columns)
    }

    fn merge(&self, later: &Self) -> Self {
        Self::keep(&TriangularFactor::merge([&self.factor(), &later.factor()]))
    }
}

fn moments(track: &Track, transitions: &[usize], basis: &Basis) -> Sums {
    let p = basis.rest.len();
    let mut e = Mat::zeros(transitions.len(), 1 + p);
    let mut y = Mat::zeros(transitions.len(), STATE_LEN);
    let (mut w, mut d) = (vec![0.0; p], vec![0.0; p]);
    for (row, &k) in transitions.iter().enumerate() {
        track.regressors(k, basis.shape.lags, &mut w);
        basis.motion(&w, &mut d);
        e[(row, 0)] = 1.0;
        for (column, &value) in d.iter().enumerate() {
            e[(row, 1 + column)] = value;
        }
        for (signal, increment) in track.increments(k).into_iter().enumerate() {
            y[(row, signal)] = increment;
        }
    }
    let quadratic = basis.shape.structure == Structure::Paper;
    Sums::Moments(Moments::of_rows(e.as_ref(), y.as_ref(), quadratic))
}

fn triangles(track: &Track, transitions: &[usize], basis: &Basis) -> Sums {
    let mut d = vec![0.0; basis.rest.len()];
    let factors = basis.shape.factors(track, transitions, |w, linear, height| {
        linear.copy_from_slice(w);
        if !height.is_empty() {
            basis.motion(w, &mut d);
            quadratic_terms(&d, &d, height);
        }
    });
    Sums::Triangles {
        linear: Triangle::keep(&factors.linear),
        height: factors.height.as_ref().map(Triangle::keep),
    }
}
