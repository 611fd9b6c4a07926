//! Finds the readings of a set that are cycles of one pose.

use thiserror::Error;

use super::LEAST_CYCLES;
use calibrig_model::measurement::MeasurementSet;

/// A pose that was measured in every cycle, for one station and target.
#[derive(Debug, Clone, PartialEq)]
pub struct TestPose {
    /// Number of the pose: that of its first reading.
    pub pose: u32,
    /// Indices of its observations, in the order in which they were taken.
    pub observations: Vec<usize>,
    /// Whether it was approached from different sides; the standard's cycles have one path.
    pub mixed_approach: bool,
}

/// Why measurements do not give a repeatability.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Iso9283Error {
    /// The target was not observed.
    #[error("target {target} was not measured")]
    NoReading {
        /// Name of the target.
        target: String,
    },
    /// Every pose was measured only once.
    #[error(
        "none of the {poses} poses of target {target} was measured more than once: repeatability needs the same command in three cycles or more (the standard: 30)"
    )]
    NoRepeats {
        /// Name of the target.
        target: String,
        /// Number of poses.
        poses: usize,
    },
    /// Only one pose was measured more than once.
    #[error(
        "only pose {pose} of target {target} was measured more than once: expected the cycles of two poses or more (the standard: five)"
    )]
    OnePose {
        /// Name of the target.
        target: String,
        /// Number of the pose.
        pose: u32,
    },
    /// The poses do not all have the same number of cycles.
    #[error(
        "target {target}: pose {fewer} was measured in {fewest} cycles, but pose {more} in {most}: expected the same number \
         at every pose"
    )]
    Unequal {
        /// Name of the target.
        target: String,
        /// The pose with the fewest.
        fewer: u32,
        /// Number of cycles of that pose.
        fewest: usize,
        /// The first pose with the most.
        more: u32,
        /// Number of cycles of that pose.
        most: usize,
    },
    /// Every pose was measured only twice.
    #[error(
        "target {target}: pose {pose} was measured in only two cycles, which always lie equally far from their barycentre: \
         expected three cycles or more (the standard: 30)"
    )]
    TwoCycles {
        /// Name of the target.
        target: String,
        /// The first pose.
        pose: u32,
    },
    /// A pose has fewer cycles than were asked for.
    #[error("target {target}: pose {pose} was measured in {found} cycles, but {asked} were asked for")]
    TooFew {
        /// Name of the target.
        target: String,
        /// Number of the pose.
        pose: u32,
        /// Number of its cycles.
        found: usize,
        /// Number of cycles asked for.
        asked: usize,
    },
    /// A pose was measured from several stations.
    #[error(
        "target {target}: pose {pose} was measured from stations {stations}, so its scatter would include that of their \
         places: expected one station per pose"
    )]
    Stations {
        /// Name of the target.
        target: String,
        /// Number of the pose.
        pose: u32,
        /// Names of the stations.
        stations: String,
    },
}

/// The poses of one target that were measured more than once, in the order of their numbers, each with the same number of cycles; with
/// `asked`, only the first `asked` cycles of each. Poses that were measured once are left out, and counted separately.
///
/// # Errors
///
/// [`Iso9283Error`].
pub fn test_poses(
    set: &MeasurementSet,
    target: usize,
    asked: Option<usize>,
) -> Result<(Vec<TestPose>, usize), Iso9283Error> {
    let name = || set.targets.get(target).map_or_else(String::new, |target| target.name.clone());
    let own = |group: &Vec<usize>| set.observations[group[0]].target == target;
    let groups: Vec<Vec<usize>> = set.same_commands().into_iter().filter(own).collect();
    if groups.is_empty() {
        return Err(Iso9283Error::NoReading { target: name() });
    }
    let count = groups.len();
    let repeated: Vec<_> = groups.into_iter().filter(|group| group.len() > 1).collect();
    if repeated.is_empty() {
        return Err(Iso9283Error::NoRepeats { target: name(), poses: count });
    }
    let mut poses = Vec::with_capacity(repeated.len());
    for mut observations in repeated {
        let pose = set.observations[observations[0]].pose;
        let station = set.observations[observations[0]].station;
        if let Some(other) = observations.iter().map(|i| set.observations[*i].station).find(|s| *s != station)
        {
            let named = |s: usize| set.stations.get(s).map_or("", |station| &station.name);
            let stations = format!("{} and {}", named(station), named(other));
            return Err(Iso9283Error::Stations { target: name(), pose, stations });
        }
        if let Some(asked) = asked {
            let found = observations.len();
            if found < asked {
                return Err(Iso9283Error::TooFew { target: name(), pose, found, asked });
            }
            observations.truncate(asked);
        }
        let approach = |i: &usize| &set.observations[*i].approach;
        let mixed_approach = observations.iter().any(|i| approach(i) != approach(&observations[0]));
        poses.push(TestPose { pose, observations, mixed_approach });
    }
    poses.sort_by_key(|pose: &TestPose| pose.pose);
    if let [only] = poses.as_slice() {
        return Err(Iso9283Error::OnePose { target: name(), pose: only.pose });
    }
    let cycles = |pose: &&TestPose| pose.observations.len();
    if let (Some(fewer), Some(most)) =
        (poses.iter().min_by_key(cycles), poses.iter().map(|p| p.observations.len()).max())
        && cycles(&fewer) != most
    {
        let more = poses.iter().find(|pose| cycles(pose) == most).map_or(0, |pose| pose.pose);
        let (fewest, fewer) = (cycles(&fewer), fewer.pose);
        return Err(Iso9283Error::Unequal { target: name(), fewer, fewest, more, most });
    }
    if let Some(first) = poses.first().filter(|pose| pose.observations.len() < LEAST_CYCLES) {
        return Err(Iso9283Error::TwoCycles { target: name(), pose: first.pose });
    }
    let once = count - poses.len();
    Ok((poses, once))
}
