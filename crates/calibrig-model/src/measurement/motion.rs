//! What the order of commands says about the way to a pose.

/// The last command of every actuator, the sign of its last motion, and how far it has moved since it last reversed.
///
/// ```
/// use calibrig_model::measurement::Motion;
///
/// let mut motion = Motion::at(&[0.0]);
/// for command in [0.1, 0.3, 0.25] {
///     motion.go_to(&[command], 1e-6);
/// }
/// assert_eq!(motion.approach, [-1]);
/// assert!((motion.since_reversal[0] - 0.05).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Motion {
    /// The last command, m or rad; empty before the first.
    pub command: Vec<f64>,
    /// Sign of each actuator's last motion, 0 before its first.
    pub approach: Vec<i8>,
    /// How far each has moved since it last reversed or, before that, since the first command, m or rad.
    pub since_reversal: Vec<f64>,
}

impl Motion {
    /// At rest at a command, without a motion before.
    pub fn at(command: &[f64]) -> Self {
        Self {
            command: command.to_vec(),
            approach: vec![0; command.len()],
            since_reversal: vec![0.0; command.len()],
        }
    }

    /// Goes to a command; a motion of up to `least`, m or rad, counts as none.
    pub fn go_to(&mut self, command: &[f64], least: f64) {
        self.approach.resize(command.len(), 0);
        self.since_reversal.resize(command.len(), 0.0);
        for (index, to) in command.iter().enumerate() {
            let moved = self.command.get(index).map_or(0.0, |from| to - from);
            if moved.abs() <= least {
                continue;
            }
            let sign = if moved > 0.0 { 1 } else { -1 };
            let before = if self.approach[index] == sign { self.since_reversal[index] } else { 0.0 };
            (self.approach[index], self.since_reversal[index]) = (sign, before + moved.abs());
        }
        command.clone_into(&mut self.command);
    }
}
