//! An orthographic camera.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// Looks along `-towards_eye` and maps metres to pixels.
#[derive(Clone, Debug)]
pub(crate) struct Camera {
    right: Vector3<f64>,
    up: Vector3<f64>,
    towards_eye: Vector3<f64>,
    pixels_per_m: f64,
    /// What of (right, up) lands in the middle of the frame.
    middle_m: [f64; 2],
    /// Where that is, in pixels from the top left.
    middle_px: [f64; 2],
}

/// The part of the picture that the body may fill, in pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub(crate) left: f64,
    pub(crate) top: f64,
    pub(crate) width: f64,
    pub(crate) height: f64,
}

impl Camera {
    /// A camera in front of `focus` (a point on the side of the body worth seeing) that gets all of
    /// `points` into `frame`.
    pub(crate) fn facing(focus: Vector3<f64>, points: &[Vector3<f64>], frame: Frame) -> Camera {
        let centre = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let spread: Matrix3<f64> =
            points.iter().map(|x| (x - centre) * (x - centre).transpose()).sum();
        let axes = SymmetricEigen::new(spread);
        let [shortest, longest] = [axes.eigenvalues.imin(), axes.eigenvalues.imax()]
            .map(|axis| axes.eigenvectors.column(axis).into_owned());
        let longest = longest * longest[longest.iamax()].signum();
        let spread_m = (axes.eigenvalues.max() / points.len().max(1) as f64).max(0.0).sqrt();
        let offset = focus - centre;
        let aside = offset - longest * offset.dot(&longest);
        // What lies in the body's middle or along its length is on no side of its own: look at the
        // broad side.
        let towards_eye = if aside.norm() > 0.1 * spread_m && aside.norm() > 0.7 * offset.norm() {
            offset.normalize()
        } else {
            shortest * if offset.dot(&shortest) < 0.0 { -1.0 } else { 1.0 }
        };
        let up = (longest - towards_eye * longest.dot(&towards_eye)).normalize();
        let right = up.cross(&towards_eye);
        // From a little to the side and above, so that depth can be seen.
        let towards_eye = (towards_eye + 0.30 * right + 0.22 * up).normalize();
        let right = up.cross(&towards_eye).normalize();
        let up = towards_eye.cross(&right);

        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for x in points {
            for (axis, direction) in [right, up].iter().enumerate() {
                low[axis] = low[axis].min(x.dot(direction));
                high[axis] = high[axis].max(x.dot(direction));
            }
        }
        let fit = |size: f64, axis: usize| size / (high[axis] - low[axis]).max(f64::MIN_POSITIVE);
        Camera {
            right,
            up,
            towards_eye,
            pixels_per_m: fit(frame.width, 0).min(fit(frame.height, 1)),
            middle_m: [0, 1].map(|axis| 0.5 * (low[axis] + high[axis])),
            middle_px: [frame.left + 0.5 * frame.width, frame.top + 0.5 * frame.height],
        }
    }

    /// Pixels from the left and the top, and depth in pixels towards the eye.
    pub(crate) fn project(&self, x: &Vector3<f64>) -> [f64; 3] {
        [
            self.middle_px[0] + self.pixels_per_m * (x.dot(&self.right) - self.middle_m[0]),
            self.middle_px[1] - self.pixels_per_m * (x.dot(&self.up) - self.middle_m[1]),
            self.pixels_per_m * x.dot(&self.towards_eye),
        ]
    }

    /// A direction given as (right, up, towards the eye).
    pub(crate) fn direction(&self, [right, up, towards_eye]: [f64; 3]) -> Vector3<f64> {
        self.right * right + self.up * up + self.towards_eye * towards_eye
    }

    /// Length of a metre in pixels.
    pub(crate) fn pixels_per_m(&self) -> f64 {
        self.pixels_per_m
    }
}
