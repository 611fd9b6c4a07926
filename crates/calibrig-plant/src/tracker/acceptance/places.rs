//! Where the reference lengths, the two-face points and the ends of ranges are, in the tracker's frame.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

/// The tests, in the order of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Test {
    /// A level length as near as a stand allows: 0.5 m, our choice.
    Near,
    /// Level at 3 m.
    Level3,
    /// Level at 6 m.
    Level6,
    /// Upright at 3 m.
    Upright3,
    /// Upright at 6 m.
    Upright6,
    /// Rising to the left at 3 m.
    LeftDiagonal3,
    /// Rising to the left at 6 m.
    LeftDiagonal6,
    /// Rising to the right at 3 m.
    RightDiagonal3,
    /// Rising to the right at 6 m.
    RightDiagonal6,
    /// Along the beam from 2 m: the user's first choice, here ours.
    AlongBeam,
    /// Upright at 3 m from the height of the tracker upwards: the user's second choice, here ours.
    UprightAbove,
    /// Two faces at 1 m.
    TwoFace1,
    /// Two faces at 3 m.
    TwoFace3,
    /// Two faces at 6 m.
    TwoFace6,
    /// Intervals of the range.
    Ranging,
}

impl Test {
    /// All of them.
    pub const ALL: [Self; 15] = [
        Self::Near,
        Self::Level3,
        Self::Level6,
        Self::Upright3,
        Self::Upright6,
        Self::LeftDiagonal3,
        Self::LeftDiagonal6,
        Self::RightDiagonal3,
        Self::RightDiagonal6,
        Self::AlongBeam,
        Self::UprightAbove,
        Self::TwoFace1,
        Self::TwoFace3,
        Self::TwoFace6,
        Self::Ranging,
    ];

    /// The key in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Near => "length_near",
            Self::Level3 => "length_level_3m",
            Self::Level6 => "length_level_6m",
            Self::Upright3 => "length_upright_3m",
            Self::Upright6 => "length_upright_6m",
            Self::LeftDiagonal3 => "length_left_diagonal_3m",
            Self::LeftDiagonal6 => "length_left_diagonal_6m",
            Self::RightDiagonal3 => "length_right_diagonal_3m",
            Self::RightDiagonal6 => "length_right_diagonal_6m",
            Self::AlongBeam => "length_along_beam",
            Self::UprightAbove => "length_upright_above",
            Self::TwoFace1 => "two_face_1m",
            Self::TwoFace3 => "two_face_3m",
            Self::TwoFace6 => "two_face_6m",
            Self::Ranging => "ranging",
        }
    }

    /// Name for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Near => "length, level, near",
            Self::Level3 => "length, level, 3 m",
            Self::Level6 => "length, level, 6 m",
            Self::Upright3 => "length, upright, 3 m",
            Self::Upright6 => "length, upright, 6 m",
            Self::LeftDiagonal3 => "length, left diagonal, 3 m",
            Self::LeftDiagonal6 => "length, left diagonal, 6 m",
            Self::RightDiagonal3 => "length, right diagonal, 3 m",
            Self::RightDiagonal6 => "length, right diagonal, 6 m",
            Self::AlongBeam => "length, along the beam",
            Self::UprightAbove => "length, upright, above",
            Self::TwoFace1 => "two faces, 1 m",
            Self::TwoFace3 => "two faces, 3 m",
            Self::TwoFace6 => "two faces, 6 m",
            Self::Ranging => "range intervals",
        }
    }

    /// Whether it measures a reference length.
    pub fn is_length(self) -> bool {
        !self.is_two_face() && self != Self::Ranging
    }

    /// Whether it measures in both faces.
    pub fn is_two_face(self) -> bool {
        matches!(self, Self::TwoFace1 | Self::TwoFace3 | Self::TwoFace6)
    }
}

/// A reference length in a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// Of which test.
    pub test: Test,
    /// Its ends in the tracker's frame, m.
    pub ends: [Vector3<f64>; 2],
}

/// Of all reference lengths, m.
const REFERENCE: f64 = 2.3;

/// From the tracker to the near length, m.
const NEAR: f64 = 0.5;

/// From which intervals of range are measured, m: our choice.
pub const RANGING_START: f64 = 2.0;

/// Intervals of range.
const INTERVALS: u32 = 10;

/// At which farthest range they end, m.
const RANGING_END: f64 = 30.0;

/// Heights of two-face points above the tracker, m: our choice, within reach of every instrument that turns by 45° up and
/// down.
const HEIGHTS: [f64; 3] = [-1.0, 0.0, 1.0];

fn azimuths() -> impl Iterator<Item = f64> {
    (0..4).map(|quarter| FRAC_PI_2 * f64::from(quarter))
}

/// Away from the tracker, and to the left as it is seen from there.
fn directions(azimuth: f64) -> [Vector3<f64>; 2] {
    let (sin, cos) = azimuth.sin_cos();
    [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0)]
}

/// The 35 places of the reference length.
pub fn lengths() -> impl Iterator<Item = Length> {
    let up = Vector3::z();
    let centred = |test, middle: Vector3<f64>, along: Vector3<f64>| {
        let half = 0.5 * REFERENCE * along.normalize();
        Length { test, ends: [middle - half, middle + half] }
    };
    let [ahead, left] = directions(0.0);
    let near = centred(Test::Near, NEAR * ahead, left);
    let at = move |distance: f64, tests: [Test; 4]| {
        azimuths().flat_map(move |azimuth| {
            let [ahead, left] = directions(azimuth);
            let along = [left, up, left + up, up - left];
            let place = move |index: usize| centred(tests[index], distance * ahead, along[index]);
            (0..4).map(place)
        })
    };
    let [three, six] = [
        [Test::Level3, Test::Upright3, Test::LeftDiagonal3, Test::RightDiagonal3],
        [Test::Level6, Test::Upright6, Test::LeftDiagonal6, Test::RightDiagonal6],
    ];
    let own = [
        Length { test: Test::AlongBeam, ends: [2.0 * ahead, (2.0 + REFERENCE) * ahead] },
        Length { test: Test::UprightAbove, ends: [3.0 * ahead, 3.0 * ahead + REFERENCE * up] },
    ];
    std::iter::once(near).chain(at(3.0, three)).chain(at(6.0, six)).chain(own)
}

/// The 36 points that are measured in both faces: at three distances over the floor, three heights and four azimuths, m.
pub fn two_face_points() -> impl Iterator<Item = (Test, Vector3<f64>)> {
    let distances = [(Test::TwoFace1, 1.0), (Test::TwoFace3, 3.0), (Test::TwoFace6, 6.0)];
    distances.into_iter().flat_map(|(test, distance)| {
        HEIGHTS.into_iter().flat_map(move |height| {
            azimuths().map(move |azimuth| {
                (test, distance * directions(azimuth)[0] + Vector3::new(0.0, 0.0, height))
            })
        })
    })
}

/// Where the intervals of range that begin at [`RANGING_START`] end, for an instrument with this reach, m.
pub fn ranging_ends(farthest: f64) -> impl Iterator<Item = f64> {
    let step = (farthest.min(RANGING_END) - RANGING_START) / f64::from(INTERVALS);
    (1..=INTERVALS).map(move |interval| RANGING_START + step * f64::from(interval))
}
