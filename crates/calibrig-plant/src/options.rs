//! When a pose counts as settled.

/// When a pose counts as settled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SettleOptions {
    /// Length of a step, s.
    ///
    /// A step starts at rest and moves the joints by `(K + M/dt²)⁻¹` times the force left over, with K the stiffness of the
    /// springs and M the mass matrix: long steps solve the statics alone. If drives are so soft that long steps overshoot, use
    /// shorter ones.
    pub dt: f64,
    /// Whether a step of rapier confirms every pose. It changes no bit of a pose and takes half of the time.
    pub confirm: bool,
    /// Steps before the pose is given up.
    pub max_steps: u32,
    /// Largest motion of the target in the last step, m.
    pub tip_tolerance: f64,
    /// Largest force left over, as the displacement that it would cause on its spring, rad or m.
    pub residual_tolerance: f64,
    /// Largest distance left between the ends of the four-bar's rod and lever, m.
    pub closure_tolerance: f64,
}

impl Default for SettleOptions {
    fn default() -> Self {
        Self {
            dt: 100.0,
            confirm: true,
            max_steps: 100,
            tip_tolerance: 1e-9,
            residual_tolerance: 1e-10,
            closure_tolerance: 1e-9,
        }
    }
}
