use calibrig_campaign::design::{Design, Sampling};
use calibrig_campaign::table::{Cell, Column, Kind, MemoryTable};
use calibrig_estimation::identification::Mode;
use calibrig_model::{ParameterId, Unit};
use serde_json::{Value, json};

use super::campaign_html;
use crate::montecarlo::{CampaignSummary, GroupSummary, Study, StudyMode, Subject, summarise};
use crate::report::plots::{LOOKS, hex, look};
use crate::report::tests::pages::assert_balanced;

/// What a table of a test holds.
struct Made {
    name: &'static str,
    scenario: &'static str,
    plant: &'static str,
    design: Design,
    factors: Value,
    tolerance: Option<f64>,
    modes: Vec<Mode>,
    parameters: Vec<ParameterId>,
    /// RMS by trial and mode, m; `None` for a trial that failed.
    rms: fn(u64, usize) -> Option<f64>,
    reason: &'static str,
}

impl Made {
    fn of(design: Design, factors: Value, rms: fn(u64, usize) -> Option<f64>) -> Self {
        Self {
            name: "spray painter",
            scenario: "scenarios/paper.toml",
            plant: "rapier",
            design,
            factors,
            tolerance: None,
            modes: vec![Mode::OnlyCalibration, Mode::ElastoGeometric],
            parameters: vec![ParameterId::Mass { link: 2 }],
            rms,
            reason: "no rank",
        }
    }

    fn summary(&self) -> CampaignSummary {
        let study = Study {
            plant: self.plant.to_owned(),
            design: self.design.clone(),
            factors: serde_json::from_value(self.factors.clone()).expect("factors"),
            machines_are_drawn: false,
            tolerance: None,
            modes: self.modes.iter().map(|mode| self.study_mode(*mode)).collect(),
        };
        let rows = (0..self.design.trials()).map(|trial| self.row(trial)).collect();
        let subject = Subject {
            name: self.name.to_owned(),
            scenario: self.scenario.to_owned(),
            seed: 7,
            sha256: "ab12".to_owned(),
            first: 0,
        };
        summarise(subject, &study, &MemoryTable::new(self.columns(), rows), self.tolerance)
            .expect("a summary")
    }

    fn page(&self) -> String {
        let page = campaign_html(&self.summary());
        assert_sound(&page);
        page
    }

    fn study_mode(&self, mode: Mode) -> StudyMode {
        StudyMode {
            mode: mode.key().to_owned(),
            parameters: self.parameters.iter().map(ToString::to_string).collect(),
        }
    }

    fn columns(&self) -> Vec<Column> {
        let kinds = [
            ("trial", Kind::Integer),
            ("status", Kind::Text),
            ("reason", Kind::Text),
            ("redrawn", Kind::Integer),
        ];
        let mut columns: Vec<Column> = kinds.map(|(name, kind)| Column::new(name, kind)).to_vec();
        let number = |name: String| Column::new(name, Kind::Number);
        for mode in self.modes.iter().map(|mode| mode.key()) {
            for set in ["identification", "verification", "truth"] {
                columns.extend(FIGURES.map(|figure| number(format!("{mode}.{set}.{figure}"))));
            }
            columns.extend(FIT.map(|name| number(format!("{mode}.{name}"))));
            for id in &self.parameters {
                let unit = match id.unit() {
                    Unit::Metre => "_m",
                    Unit::Radian => "_rad",
                    Unit::One => "",
                };
                columns.extend(PARAMETER.map(|figure| number(format!("{mode}.{id}.{figure}{unit}"))));
            }
        }
        columns
    }

    fn row(&self, trial: u64) -> Vec<Cell> {
        let all: Option<Vec<f64>> = (0..self.modes.len()).map(|mode| (self.rms)(trial, mode)).collect();
        let (status, reason) =
            if all.is_some() { ("ok", Cell::Absent) } else { ("failed", Cell::text(self.reason)) };
        let mut cells = vec![Cell::count(trial), Cell::text(status), reason, Cell::count(0_u32)];
        let wide = 3 * FIGURES.len() + FIT.len() + PARAMETER.len() * self.parameters.len();
        let Some(all) = all else {
            cells.resize(4 + wide * self.modes.len(), Cell::Absent);
            return cells;
        };
        for rms in all {
            let number = |value: f64| if value.is_finite() { Cell::Number(value) } else { Cell::Absent };
            cells.extend((0..24).map(|place| number(if place % 8 == 7 { 2.0 * rms } else { rms })));
            // Sound, iterations, chi-square, NEES of four parameters, squared error, coverage of 19 of 20.
            cells.extend(
                [1.0, 6.0, 1.0 + noise(trial), 4.0 + noise(trial), 4.0, 4.0, 19.0, 20.0].map(Cell::Number),
            );
            for _ in &self.parameters {
                cells.extend([1e-4 * noise(trial), 0.0, 1e-4, 1e-4].map(Cell::Number));
                cells.push(Cell::Absent);
            }
        }
        cells
    }
}

const FIGURES: [&str; 8] =
    ["max_x_m", "max_y_m", "max_z_m", "mean_x_m", "mean_y_m", "mean_z_m", "rms_3d_m", "max_3d_m"];
const FIT: [&str; 8] = [
    "sound",
    "iterations",
    "chi2_per_dof",
    "nees",
    "parameter_count",
    "squared_over_bound",
    "predictions_inside",
    "predictions",
];
const PARAMETER: [&str; 5] = ["estimate", "truth", "sigma", "cramer_rao", "bayesian"];

/// Between -1 and 1, different for different trials.
fn noise(trial: u64) -> f64 {
    (trial * 37 % 101) as f64 / 50.0 - 1.0
}

fn plain(trials: u64) -> Design {
    Design::Plain { trials, factors: 0, sampling: Sampling::Random }
}

fn factor(name: &str, levels: &[&str]) -> Value {
    json!({ "name": name, "keys": ["key"], "scale": false, "whole": false, "values": { "levels": levels } })
}

/// 1 mm and 0.1 mm, within a tenth; no trial fails.
#[allow(clippy::unnecessary_wraps)]
fn usual(trial: u64, mode: usize) -> Option<f64> {
    Some([1e-3, 1e-4][mode % 2] * (1.0 + 0.1 * noise(trial)))
}

/// The same, but every tenth trial fails.
fn some_fail(trial: u64, mode: usize) -> Option<f64> {
    usual(trial, mode).filter(|_| trial % 10 != 3)
}

fn assert_sound(page: &str) {
    assert_balanced(page);
    for wrong in
        ["<script", "<link", "<img", "src=", "@import", "url(", "NaN", ">inf<", ">-inf<", "cannot draw"]
    {
        assert!(!page.contains(wrong), "{wrong}");
    }
    for (at, _) in page.match_indices("href=\"#") {
        let id = page[at + 7..].split('"').next().expect("an anchor");
        assert!(page.contains(&format!("id=\"{id}\"")), "{id}");
    }
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
}

fn section<'a>(page: &'a str, id: &str) -> &'a str {
    let rest =
        page.split_once(&format!("<section id=\"{id}\">")).unwrap_or_else(|| panic!("no section {id}")).1;
    rest.split_once("</section>").expect("its end").0
}

#[test]
fn a_plain_campaign_tells_accuracy_tolerance_and_how_to_do_it_again() {
    let made = Made { tolerance: Some(1e-4), ..Made::of(plain(200), json!([]), some_fail) };
    let (summary, page) = (made.summary(), made.page());
    assert!(!page.contains("matched model"));
    assert!(
        page.contains("20 of 200 trials failed.")
            && page.contains("<td class=\"words\">no rank</td><td>20</td><td>3</td>")
    );
    let accuracy = section(&page, "distribution");
    let set = summary.modes()[1].told().expect("a held-out set");
    // 0.1 mm within 0.1: known within a per cent of it, so with five digits.
    let mean =
        format!(">{:.5} \u{b1} {:.5}<", 1e3 * set.rms_3d.mean, 1e3 * set.rms_3d.half_width.expect("many"));
    assert!(accuracy.contains(&mean), "{mean}");
    let within = set.rms_within.expect("a tolerance");
    assert!(accuracy.contains(&format!("{} of 200", within.hits)) && within.hits > 50 && within.hits < 150);
    assert!(accuracy.contains("Dashed: the tolerance, 0.1 mm."));
    // 180 trials fill 10 bins of a mode: each is a rectangle in its colour.
    let bars =
        |mode: Mode| accuracy.matches(&format!("opacity=\"0.4\" fill=\"{}\"", hex(look(mode).light))).count();
    assert!((6..=10).contains(&bars(Mode::OnlyCalibration)), "{}", bars(Mode::OnlyCalibration));
    let reproduce = section(&page, "reproduce");
    assert!(reproduce.contains("calibrig montecarlo scenarios/paper.toml --trials 200 --seed 7 --plant rapier --tolerance 0.1mm --out DIR"));
    assert!(reproduce.contains("elasto_geometric.truth.rms_3d_m") && reproduce.contains("ab12"));
    let worst = section(&page, "worst");
    assert_eq!(
        worst.matches("<code>calibrig run scenarios/paper.toml --seed 7 --plant rapier --trial ").count(),
        5
    );
    assert!(worst.contains(&format!("{}<", summary.rerun_command(summary.worst[0].trial))));
}

#[test]
fn a_matched_model_is_called_one_in_front_of_all_figures() {
    let page = Made { plant: "analytic", ..Made::of(plain(20), json!([]), usual) }.page();
    let told = page.find("tests the estimator, not the method").expect("the label");
    assert!(told < page.find("<section").expect("a section"));
    assert!(page.contains("--plant analytic"));
}

#[test]
fn uncertainties_are_held_against_their_bands_and_parameters_are_drawn_and_folded() {
    let page = Made::of(plain(50), json!([]), usual).page();
    let own = section(&page, "consistency");
    // NEES over parameters is 1 + noise / 4: inside.
    let summary = Made::of(plain(50), json!([]), usual).summary();
    let nees = summary.modes()[0].nees.expect("known");
    assert!(own.contains(&format!(">{:.4}</span>", nees.mean / 4.0)), "{}", nees.mean);
    assert!(own.contains(&format!("[{:.4}, {:.4}]", nees.band.0 / 4.0, nees.band.1 / 4.0)));
    let names = own.matches(&format!("\n{}\n", ParameterId::Mass { link: 2 })).count();
    assert_eq!(names, 1, "one row of the figure for both modes");
    assert!(
        own.split_once("Figures of every parameter").expect("a fold").1.contains("<th scope=\"row\" title=")
    );
    // Too certain by far: the covariance is told to be outside in bold.
    let mut summary = summary;
    if let Some(nees) = &mut summary.groups[0].modes[0].nees {
        nees.mean = 40.0;
    }
    assert!(campaign_html(&summary).contains("<span class=\"far\">10.0000</span>"));
}

#[test]
fn a_sweep_has_bands_levels_and_paired_differences() {
    let design = Design::Sweep { levels: vec![4], repeats: 20 };
    let rms = |trial: u64, mode: usize| {
        usual(trial % 20, mode).filter(|_| trial != 79).map(|rms| rms / (1.0 + (trial / 20) as f64))
    };
    let made = Made {
        tolerance: Some(1e-3),
        ..Made::of(design, json!([factor("poses", &["20", "40", "60", "100"])]), rms)
    };
    let (summary, page) = (made.summary(), made.page());
    assert!(!page.contains("id=\"distribution\""));
    let own = section(&page, "sweep");
    for level in ["20", "40", "60", "100", "poses"] {
        assert!(own.contains(&format!("\n{level}\n")), "{level} on the axis");
    }
    for look in [look(Mode::OnlyCalibration), look(Mode::ElastoGeometric)] {
        for strength in ["0.14", "0.3"] {
            assert_eq!(
                own.matches(&format!("<polygon opacity=\"{strength}\" fill=\"{}\"", hex(look.light))).count(),
                1,
                "a band"
            );
        }
    }
    // Half of the first, draw by draw: the difference is 0.5 mm, and minus where it is less.
    let difference = summary.groups[1].modes[0].told().expect("a set").against_first.expect("paired");
    let half = difference.interval.expect("many").half_width();
    assert!(
        own.contains(&format!("\u{2212}{:.3} \u{b1} {:.3}", -1e3 * difference.value, 1e3 * half)),
        "{difference:?}"
    );
    assert!(own.contains("<td class=\"far\">1</td>"), "a failed trial of the last level");
    assert_eq!(own.matches("<tr><th scope=\"row\">").count(), 8, "a row a level and mode");
    assert!(section(&page, "consistency").contains("summary.json"));
    assert!(page.contains("further trials of every combination") && page.contains("--trials 80"));
}

#[test]
fn two_factors_are_panels_and_a_shaded_table() {
    let design = Design::Sweep { levels: vec![3, 3], repeats: 4 };
    let rms = |trial: u64, mode: usize| {
        usual(trial % 4, mode).map(|rms| rms * 10.0_f64.powf(0.25 * (trial / 4) as f64))
    };
    let factors = json!([
        factor("poses", &["20", "40", "60"]),
        factor("where", &["\"near\"", "\"far\"", "\"all over\""])
    ]);
    let page = Made::of(design, factors, rms).page();
    let own = section(&page, "sweep");
    for panel in ["poses = 20", "poses = 40", "poses = 60"] {
        assert_eq!(own.matches(&format!("\n{panel}\n")).count(), 1, "{panel}");
    }
    assert_eq!(own.matches("\nall over\n").count(), 3, "a level without its quotes below every panel");
    assert_eq!(own.matches("<td style=\"background:rgb(").count(), 18, "nine cells a mode");
    assert_eq!(
        (own.matches(" / 0.06)").count(), own.matches(" / 0.50)").count()),
        (2, 2),
        "least and largest of both modes"
    );
    // A hundredfold: the axis is logarithmic, with a line at 0.1 and at 100.
    assert!(own.contains("\n0.1\n") && own.contains("\n100\n"));
}

#[test]
fn indices_and_screening_rank_the_factors() {
    let factors = json!([factor("little", &["1", "2"]), factor("much", &["1", "2"])]);
    // By the rows of the base: A, B, A with one factor of B's, and A with B's draw.
    let rms = |trial: u64, _: usize| {
        let row = trial / 5;
        let (a, b) = (noise(3 * row), noise(3 * row + 50));
        Some(
            1e-3 * (2.0
                + match trial % 5 {
                    0 | 4 => a,
                    2 => a + 0.01 * (b - a),
                    _ => b,
                }),
        )
    };
    let design = Design::Indices { base: 64, factors: 2, draws: true, sampling: Sampling::Random };
    let page = Made::of(design, factors.clone(), rms).page();
    let own = section(&page, "sensitivity");
    let place = |name: &str| {
        own.find(&format!("<th scope=\"row\">{name}</th>")).unwrap_or_else(|| panic!("no {name}"))
    };
    assert!(place("much") < place("little") && place("draws") > 0);
    assert!(own.contains("total index") && own.contains("first-order index"));
    assert_eq!(
        own.matches("<rect").count() - own.matches("<rect x=\"-4\"").count(),
        12,
        "a bar a factor, index and mode"
    );
    let design = Design::Screening { trajectories: 10, factors: 2, levels: 4 };
    let page = Made { name: "screened", ..Made::of(design, factors, usual) }.page();
    let own = section(&page, "sensitivity");
    assert!(
        own.contains("mean size (mu*), mm")
            && own.contains("scatter (sigma), mm")
            && own.contains("<th scope=\"row\">much</th>")
    );
}

#[test]
fn nothing_but_failures_is_told_with_its_reason() {
    for design in [
        plain(9),
        Design::Sweep { levels: vec![3], repeats: 3 },
        Design::Screening { trajectories: 3, factors: 1, levels: 4 },
    ] {
        let page = Made::of(design, json!([factor("poses", &["20", "40", "60"])]), |_, _| None).page();
        assert!(page.contains("9 of 9 trials failed.") || page.contains("6 of 6 trials failed."));
        assert!(
            page.contains(">no rank</td>")
                && !page.contains("id=\"worst\"")
                && !page.contains("id=\"consistency\"")
        );
        assert!(page.contains("No trial has an accuracy."));
    }
}

#[test]
fn no_string_of_a_file_reaches_the_page_as_it_is() {
    const HOSTILE: &str = "<script>alert(\"1\")</script> & 'co'\u{1b}[31m\n";
    let escaped = "&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt; &amp; 'co'";
    let made = Made {
        name: HOSTILE,
        scenario: "a '<script>' b.toml",
        plant: HOSTILE,
        reason: HOSTILE,
        ..Made::of(
            Design::Sweep { levels: vec![2, 2], repeats: 5 },
            json!([factor(HOSTILE, &[HOSTILE, "2"]), factor(HOSTILE, &["\"<b>\"", "4"])]),
            some_fail,
        )
    };
    let page = made.page();
    // Title, heading, plant, design, factors and levels of the tables, and the reason.
    assert!(page.matches(escaped).count() >= 8, "{}", page.matches(escaped).count());
    assert!(!page.contains('\u{1b}') && !page.contains("<b>"));
    assert!(page.contains("calibrig montecarlo 'a '\\''&lt;script&gt;'\\'' b.toml'"));
}

#[test]
fn a_page_stays_small_at_any_number_of_levels_and_parameters() {
    let level = |place: u64| format!("{place} {}", "<long>".repeat(200));
    let levels: Vec<String> = (0..40).map(level).collect();
    let levels: Vec<&str> = levels.iter().map(String::as_str).collect();
    let design = Design::Sweep { levels: vec![2, 2], repeats: 5 };
    let factors = json!([factor("a", &levels), factor("b", &levels)]);
    let mut summary =
        Made { modes: Mode::ALL.to_vec(), tolerance: Some(1e-3), ..Made::of(design, factors, usual) }
            .summary();
    let like = summary.groups[1].clone();
    let group =
        |place: u64| GroupSummary { levels: vec![level(place / 40), level(place % 40)], ..like.clone() };
    summary.groups = (0..1600).map(group).collect();
    let page = campaign_html(&summary);
    assert_sound(&page);
    println!("{} bytes with 1600 combinations", page.len());
    let parameters = ParameterId::all_of_links(80);
    assert!(parameters.len() > 300);
    let made = Made { modes: Mode::ALL.to_vec(), parameters, ..Made::of(plain(3), json!([]), usual) };
    println!("{} bytes with many parameters", made.page().len());
}

#[test]
fn no_value_of_a_table_stops_the_page() {
    let usual_bad: [fn(u64, usize) -> Option<f64>; 6] = [
        |_, _| Some(0.0),
        |_, _| Some(1e-300),
        |_, _| Some(1e300),
        |_, _| Some(f64::NAN),
        |trial, _| Some(if trial % 2 == 0 { 1e-9 } else { 1e9 }),
        |_, _| Some(1e-3),
    ];
    for rms in usual_bad {
        for design in [plain(1), plain(12), Design::Sweep { levels: vec![2], repeats: 3 }] {
            let made = Made {
                tolerance: Some(1e-4),
                ..Made::of(design, json!([factor("x", &["1e300", "2"])]), rms)
            };
            assert!(made.page().ends_with("</html>"));
        }
    }
}

#[test]
fn colours_are_those_of_the_modes() {
    let page = Made::of(plain(30), json!([]), usual).page();
    for look in LOOKS {
        // The style sheet replaces each in the dark.
        assert!(page.contains(&format!("svg [fill=\"{}\"]{{fill:{}}}", hex(look.light), hex(look.dark))));
    }
}
