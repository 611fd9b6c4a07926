//! Typical figures of robots of a size, for what their files do not state: with sources or reasons, which are written into the scenario.

use std::fmt;

/// How large a robot is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SizeClass {
    /// Such as a UR5, an iiwa, an IRB 120: reaches up to 1.4 m and weighs up to 60 kg.
    Small,
    /// Such as a KR 240: reaches up to 3.2 m and weighs up to 1500 kg.
    Medium,
    /// Beyond: robots on rails, gantries, painters of aircraft.
    Large,
}

/// Reach (m) and moving mass (kg) up to which a robot is small, or medium.
const SMALL: (f64, f64) = (1.4, 60.0);
const MEDIUM: (f64, f64) = (3.2, 1500.0);

impl SizeClass {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Small, Self::Medium, Self::Large];

    /// By reach, m, and moving mass, kg, if known: the larger of the two.
    pub fn of(reach: f64, mass: Option<f64>) -> Self {
        let mass = mass.unwrap_or(0.0);
        let within = |(most_reach, most_mass): (f64, f64)| reach <= most_reach && mass <= most_mass;
        match () {
            () if within(SMALL) => Self::Small,
            () if within(MEDIUM) => Self::Medium,
            () => Self::Large,
        }
    }

    /// The key on the command line.
    pub fn key(self) -> &'static str {
        match self {
            Self::Small => "small",
            Self::Medium => "medium",
            Self::Large => "large",
        }
    }

    /// The rule, in words.
    pub(super) fn rule(self) -> String {
        match self {
            Self::Small => format!("reaches up to {} m and moves up to {} kg", SMALL.0, SMALL.1),
            Self::Medium => format!("reaches up to {} m and moves up to {} kg", MEDIUM.0, MEDIUM.1),
            Self::Large => format!("reaches beyond {} m, or moves more than {} kg", MEDIUM.0, MEDIUM.1),
        }
    }

    pub(super) fn figures(self) -> Figures {
        match self {
            Self::Small => SMALL_FIGURES,
            Self::Medium => MEDIUM_FIGURES,
            Self::Large => LARGE_FIGURES,
        }
    }
}

impl fmt::Display for SizeClass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.key())
    }
}

/// The figures of a class, in the units of the scenario's keys.
pub(super) struct Figures {
    /// Standard deviations of lengths (mm) and angles (mrad) as built, and their source.
    pub lengths: f64,
    pub angles: f64,
    pub errors_why: &'static str,
    /// Of a four-bar's crank: displacement of its axis from the shoulder's along x and y (mm), and its tilts (mrad),
    /// and their source.
    pub crank_axis: [f64; 2],
    pub crank_axis_why: &'static str,
    /// Stiffness of drives that carry most of the arm, of those of the wrist (N m/rad), and of slides (N/m).
    pub main_drive: f64,
    pub wrist_drive: f64,
    pub slide: f64,
    pub stiffness_why: &'static str,
    /// Once and twice per motor turn, arcsec; motor turns per revolution if the robot's file does not state them.
    pub harmonics: [f64; 2],
    pub turns_per_rev: f64,
    pub harmonics_why: &'static str,
    /// For slides: um once and twice per motor turn, turns per metre, error of the pitch in ppm.
    pub slide_harmonics: [f64; 2],
    pub turns_per_m: f64,
    pub slide_ppm: f64,
    /// arcsec, um
    pub backlash: [f64; 2],
    pub backlash_why: &'static str,
    /// arcsec, um
    pub repeatability: [f64; 2],
    pub repeatability_why: &'static str,
    /// ppm/K, s
    pub expansion: f64,
    pub lag: f64,
    pub thermal_why: &'static str,
    /// Radius of links without shapes, mm.
    pub radius: f64,
    /// Offset of the target in the flange frame, mm.
    pub target: [f64; 3],
}

/// Strain-wave gears at every joint, links of aluminium.
const SMALL_FIGURES: Figures = Figures {
    lengths: 0.3,
    angles: 0.5,
    errors_why: "A UR5's nominal table leaves 0.56 to 0.71 mm RMS (public data of P. Jacobi), a FANUC LR Mate 200iC 0.62 mm mean (Joubair et al.).",
    crank_axis: [0.025, 0.25],
    crank_axis_why: "ISO 2768-2, class H: seats in one part run out by at most 0.1 mm, so that their axes are at most 0.05 mm apart. Two standard deviations; so for each of two seats 100 mm apart.",
    main_drive: 3e4,
    wrist_drive: 1e4,
    slide: 5e6,
    stiffness_why: "The shoulder of a UR5 identified from public data has 3.4e4 N m/rad; gears of the wrist are a size or two smaller.",
    harmonics: [8.0, 25.0],
    turns_per_rev: 100.0,
    harmonics_why: "Strain-wave gears: data sheets state a positional accuracy of 1 to 1.5 arcmin from peak to peak, most of it twice a turn of the wave generator.",
    slide_harmonics: [5.0, 2.0],
    turns_per_m: 100.0,
    slide_ppm: 50.0,
    backlash: [25.0, 10.0],
    backlash_why: "Strain-wave gears have no play; their hysteresis under little load is some tenths of an arcmin, which acts alike.",
    repeatability: [4.0, 5.0],
    repeatability_why: "Data sheets state 0.01 to 0.1 mm at the flange; about 0.03 mm here.",
    expansion: 23.0,
    lag: 1200.0,
    thermal_why: "Links of aluminium.",
    radius: 60.0,
    target: [50.0, 30.0, 60.0],
};

/// Cycloidal gears at the main axes, links of cast iron and aluminium.
const MEDIUM_FIGURES: Figures = Figures {
    lengths: 0.8,
    angles: 0.8,
    errors_why: "Published before calibration: an ABB IRB 2400 1.75 mm median, a PUMA 500 2.03 mm (Motta et al.).",
    crank_axis: [0.05, 0.25],
    crank_axis_why: "ISO 2768-2, class K: seats in one casting run out by at most 0.2 mm, so that their axes are at most 0.1 mm apart. Two standard deviations; so for each of two seats 200 mm apart.",
    main_drive: 1e6,
    wrist_drive: 2e5,
    slide: 2e7,
    stiffness_why: "The order that Dumas et al., Robot. Comput.-Integr. Manuf. 27 (2011) 881, identify on a KUKA KR 240-2; the wrist is softer.",
    harmonics: [20.0, 10.0],
    turns_per_rev: 120.0,
    harmonics_why: "Cycloidal gears: makers state a transmission error of about an arcmin from peak to peak, the worst of a series.",
    slide_harmonics: [30.0, 10.0],
    turns_per_m: 20.0,
    slide_ppm: 150.0,
    backlash: [30.0, 60.0],
    backlash_why: "Cycloidal gears: lost motion of 0.3 to 0.6 arcmin on average (Nabtesco).",
    repeatability: [5.0, 15.0],
    repeatability_why: "An ABB IRB 1600 repeats better than 0.037 mm (Slamani et al., Ind. Robot 39 (2012) 57); about 0.05 mm here.",
    expansion: 12.0,
    lag: 1800.0,
    thermal_why: "Links of cast iron and steel; aluminium has twice as much.",
    radius: 120.0,
    target: [100.0, 60.0, 120.0],
};

/// Large cycloidal gears, racks, welded steel.
const LARGE_FIGURES: Figures = Figures {
    lengths: 5.0,
    angles: 3.0,
    errors_why: "The 24 errors of the published spray-painting robot (Machines 2023, 11, 20) are 0.9 to 21 mm and 0.1 to 17 mrad; scenarios/matched.toml draws with the same sizes.",
    crank_axis: [0.125, 0.3],
    crank_axis_why: "ISO 2768-2, class L: seats in one weldment run out by at most 0.5 mm, so that their axes are at most 0.25 mm apart. Two standard deviations; so for each of two seats 400 mm apart.",
    main_drive: 2e6,
    wrist_drive: 2e5,
    slide: 2e7,
    stiffness_why: "Twice the order identified on a KUKA KR 240-2 (Dumas et al. 2011); racks and spindles as in models/spray_painter.",
    harmonics: [40.0, 15.0],
    turns_per_rev: 150.0,
    harmonics_why: "Large gears: 30 to 90 arcsec of transmission error, as in scenarios/paper.toml; racks by their teeth.",
    slide_harmonics: [100.0, 30.0],
    turns_per_m: 10.0,
    slide_ppm: 250.0,
    backlash: [60.0, 300.0],
    backlash_why: "Play of gears and racks: about an arcmin, some tenths of a millimetre.",
    repeatability: [6.0, 40.0],
    repeatability_why: "Large robots on rails repeat to about 0.1 mm.",
    expansion: 11.5,
    lag: 1800.0,
    thermal_why: "Welded steel.",
    radius: 200.0,
    target: [100.0, 150.0, 200.0],
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_larger_of_reach_and_mass_decides() {
        assert_eq!(SizeClass::of(0.95, Some(20.0)), SizeClass::Small);
        assert_eq!(SizeClass::of(0.95, None), SizeClass::Small);
        assert_eq!(SizeClass::of(0.95, Some(200.0)), SizeClass::Medium);
        assert_eq!(SizeClass::of(2.7, Some(1100.0)), SizeClass::Medium);
        assert_eq!(SizeClass::of(1.2, Some(4000.0)), SizeClass::Large);
        assert_eq!(SizeClass::of(6.0, None), SizeClass::Large);
    }

    #[test]
    fn larger_robots_are_stiffer_and_less_exact() {
        for pair in SizeClass::ALL.windows(2) {
            let [small, large] = [pair[0].figures(), pair[1].figures()];
            assert!(small.lengths < large.lengths && small.angles < large.angles);
            assert!(small.crank_axis[0] < large.crank_axis[0] && small.crank_axis[1] <= large.crank_axis[1]);
            assert!(small.main_drive < large.main_drive && small.wrist_drive <= large.wrist_drive);
            assert!(large.wrist_drive < large.main_drive && small.repeatability[0] < large.repeatability[0]);
        }
    }
}
