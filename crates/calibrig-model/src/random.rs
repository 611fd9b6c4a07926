//! Counter-based random streams: a number depends only on (seed, trial, source) and its place in that stream.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// What a stream is drawn for. The numbers are frozen: changing one changes every published result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u64)]
pub enum StreamSource {
    /// Pose draws of the identification set.
    IdentificationPoses = 1,
    /// Pose draws of the verification set.
    VerificationPoses = 2,
    /// Noise of the tracker on the identification poses.
    IdentificationNoise = 3,
    /// Noise of the tracker on the verification poses.
    VerificationNoise = 4,
    /// Noise of the tracker on the base nests, and the error of the nests' certified coordinates.
    NestNoise = 5,
    /// The error of the measured target offset.
    TargetOffset = 6,
    /// The as-built robot, if it is drawn.
    AsBuilt = 7,
    /// Differences between approaches of a pose; its place in the stream is the pose's.
    Repeatability = 8,
    /// Which readings are gross errors, and how far off they are; their place in the stream is the pose's.
    Outliers = 9,
    /// Random splits of a measured set.
    Splits = 10,
    /// Which poses are held out together when models are compared.
    Folds = 11,
    /// Starting points of a solver; the start's number is in the place of the trial's.
    SolverStarts = 12,
    /// Trial poses for making a robot's scenario.
    Twin = 14,
    /// The systematic errors of a tracker; its place in the stream counts instruments that failed their acceptance test.
    Instrument = 20,
    /// Noise of a tracker's acceptance test; its place in the stream is the instrument's.
    Acceptance = 21,
    /// The errors of the sensors of air temperature, pressure and humidity.
    Environment = 22,
    /// The motion of a tracker on its stand; its place in the stream is the station's.
    Drift = 23,
    /// The centring of reflectors; their place in the stream is the target's.
    Smr = 24,
    /// Which readings are missing; their place in the stream is the pose's.
    Misses = 25,
    /// Noise of the tracker on the sweeps of single joints.
    SweepNoise = 26,
    /// Noise of measured orientations; its place in the stream is the pose's.
    ProbeNoise = 30,
    /// The error of the measured orientation of a probe on the flange.
    ProbeMounting = 31,
    /// Readings of several kinds of targets at the same poses; their place in the stream is that of set, pose and point.
    SensorComparison = 32,
    /// Noise of the tracker on the cycles of a pose test (ISO 9283).
    Iso9283Noise = 40,
    /// Draws behind the intervals of a repeatability.
    Iso9283Intervals = 41,
    /// Random starts of a search for informative poses; the start's number is in the place of the trial's.
    PlannedStarts = 50,
    /// Robots drawn within their tolerances, for which poses are planned; the robot's number is in the place of the
    /// trial's.
    PlannedRobots = 51,
    /// Orders of poses from which a search starts; the start's number is in the place of the trial's.
    PlannedOrder = 52,
    /// Poses at which reduced forms of an identified robot are fitted and compared; their place in the stream is the pose's.
    Handover = 60,
    /// Noise of the tracker along a path that is driven with corrected commands.
    PathNoise = 61,
    /// The points of a study: the values of its factors in a trial. The number of the point's draw is in the place of the
    /// trial's.
    Factors = 70,
}

/// The stream of `(seed, trial, source)`. `ChaCha8` with the seed as key and (trial, source) as stream number.
pub fn stream(seed: u64, trial: u32, source: StreamSource) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((u64::from(trial) << 16) | source as u64);
    rng
}

/// The stream at the place of entry `index`, such as a pose: its draws do not depend on earlier ones. An entry has 2^20 words.
pub fn stream_at(seed: u64, trial: u32, source: StreamSource, index: u64) -> ChaCha8Rng {
    let mut rng = stream(seed, trial, source);
    rng.set_word_pos(u128::from(index) << 20);
    rng
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    #[test]
    fn streams_differ_by_seed_trial_and_source_and_repeat() {
        let first = |seed, trial, source| stream(seed, trial, source).random::<u64>();
        let reference = first(1, 0, StreamSource::NestNoise);
        assert_eq!(reference, first(1, 0, StreamSource::NestNoise));
        assert_ne!(reference, first(2, 0, StreamSource::NestNoise));
        assert_ne!(reference, first(1, 1, StreamSource::NestNoise));
        assert_ne!(reference, first(1, 0, StreamSource::TargetOffset));
    }

    #[test]
    fn entries_of_a_stream_are_places_in_it() {
        let at = |index| stream_at(1, 0, StreamSource::Repeatability, index).random::<u64>();
        assert_eq!(at(0), stream(1, 0, StreamSource::Repeatability).random::<u64>());
        assert_eq!(at(5), at(5));
        assert_ne!(at(5), at(6));
    }
}
