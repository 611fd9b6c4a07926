//! Refused plans: which, why, and what to do.

use nalgebra::{DMatrix, Matrix3};

use super::robots::{LIMITS, arm, options, set};
use super::{names, random_rows, space};
use crate::identification::Mode;
use crate::planning::{
    Choice, Criterion, DesignRows, DesignSpace, ParameterScale, PlanError, PlannedSession,
    candidate_commands, choose, grow,
};
use calibrig_model::PoseQuery;
use calibrig_model::measurement::{MeasurementSet, Reading};

#[test]
fn designs_that_cannot_be() {
    let rows = random_rows(1, 9, 5, false);
    let own = [space(&rows)];
    let of = |choice: Choice| choose(&own, &choice).expect_err("refused");
    assert_eq!(of(Choice::of(0)), PlanError::NoPoses);
    assert_eq!(of(Choice::of(10)), PlanError::TooFewCandidates { candidates: 9, wanted: 10 });
    // One pose has at most three rows, and determines three of five parameters.
    let few = of(Choice::of(1));
    assert_eq!(few, PlanError::TooFewPoses { count: 1, rows: 3, determined: 3, parameters: 5, least: 2 });
    assert!(few.to_string().contains("3 of 5 parameters: expected at least 2 poses, or a prior"), "{few}");
    assert!(choose(&own, &Choice { repeats: true, ..Choice::of(10) }).is_ok());
    assert_eq!(choose(&[], &Choice::of(3)).expect_err("refused"), PlanError::NoCandidates);
    assert_eq!(grow(&own, &Choice::of(1), &[]).expect_err("refused"), PlanError::NoPoses);
    assert!(matches!(grow(&own, &Choice::of(1), &[1]), Err(PlanError::TooFewPoses { .. })));
    assert!(matches!(grow(&own, &Choice::of(1), &[4, 20]), Err(PlanError::TooFewCandidates { .. })));
    let other = space(&random_rows(1, 8, 5, false));
    let robots = [own[0].clone(), other];
    assert!(matches!(choose(&robots, &Choice::of(4)), Err(PlanError::Length { .. })));
    assert!(matches!(own[0].figures(&[0, 9]), Err(PlanError::Number { .. })));
    assert!(matches!(own[0].figures(&[0]), Err(PlanError::Singular { what: "the chosen poses", .. })));

    let nowhere = [space(&DesignRows { region: Vec::new(), ..rows.clone() })];
    for criterion in [Criterion::I, Criterion::G] {
        let error = choose(&nowhere, &Choice { criterion, ..Choice::of(4) }).expect_err("refused");
        assert_eq!(error, PlanError::NoRegion { criterion });
        assert!(error.to_string().contains("expected poses where the robot will work"));
    }
    assert!(choose(&nowhere, &Choice { criterion: Criterion::A, ..Choice::of(4) }).is_ok());
}

/// Without a prior the error names the dependent parameters; a prior solves it.
#[test]
fn parameters_that_no_candidate_tells_apart_are_named() {
    let mut rows = random_rows(2, 9, 5, false);
    for candidate in &mut rows.candidates {
        let twice = candidate.column(1) * 2.0;
        candidate.set_column(3, &twice);
        candidate.column_mut(4).fill(0.0);
    }
    let error = choose(&[space(&rows)], &Choice::of(5)).expect_err("refused");
    let PlanError::Singular { what: "the candidate poses", groups } = &error else { panic!("{error:?}") };
    let redundant: Vec<_> = groups.iter().map(|group| group.redundant).collect();
    assert_eq!(redundant, [names(5)[3], names(5)[4]]);
    let text = error.to_string();
    assert!(
        text.contains("delta_theta4 with delta_theta2") && text.contains("delta_theta5 without effect"),
        "{text}"
    );
    rows.fixed = DMatrix::identity(5, 5) * 0.01;
    for criterion in Criterion::ALL {
        let design = choose(&[space(&rows)], &Choice { criterion, ..Choice::of(1) }).expect("a design");
        assert!(design.value.is_finite());
    }
}

#[test]
fn rows_that_cannot_be() {
    let rows = random_rows(3, 4, 3, true);
    let of =
        |rows: &DesignRows| DesignSpace::new(names(3), rows, &ParameterScale::Effect).expect_err("refused");
    let mut bad = rows.clone();
    bad.candidates[2][(0, 1)] = f64::NAN;
    assert_eq!(of(&bad).to_string(), "a row of candidate 3 is not a finite number");
    let mut bad = rows.clone();
    bad.region[1] = DMatrix::zeros(3, 4);
    assert_eq!(of(&bad).to_string(), "a row of pose 2 of the region: 4 entries, expected 3");
    let mut bad = rows.clone();
    bad.beside = vec![1.0];
    assert!(of(&bad).to_string().contains("variances over the region: 1 entries, expected 4"));
    bad.beside = vec![1.0, 0.0, -1.0, 0.0];
    assert!(of(&bad).to_string().contains("is -1: expected a finite number of zero or more"));
    assert_eq!(of(&DesignRows { candidates: Vec::new(), ..rows.clone() }), PlanError::NoCandidates);
    assert!(matches!(
        DesignSpace::new(Vec::new(), &rows, &ParameterScale::Effect),
        Err(PlanError::Number { .. })
    ));
    for scale in [vec![1.0; 2], vec![1.0, 0.0, 1.0], vec![1.0, f64::INFINITY, 1.0]] {
        assert!(DesignSpace::new(names(3), &rows, &ParameterScale::Given(scale)).is_err());
    }
}

#[test]
fn sessions_that_cannot_be() {
    let model = arm();
    let whole = set(&model, &candidate_commands(&model, &LIMITS, 12).expect("candidates"));
    let options = options(Mode::OnlyCalibration);
    let of = |set: &MeasurementSet, measured: &[u32], region: &[PoseQuery<'_>]| {
        PlannedSession::new(&model, set, &options, None, measured, region).expect_err("refused").to_string()
    };
    let none = MeasurementSet { observations: Vec::new(), ..whole.clone() };
    assert!(of(&none, &[], &[]).contains("there is no candidate pose"));
    let all: Vec<u32> = (1..=12).collect();
    assert!(of(&whole, &all, &[]).contains("there is no candidate pose"));
    assert!(of(&whole, &[3, 13], &[]).contains("pose 13 is listed as measured"));
    let changed = |change: &dyn Fn(&mut MeasurementSet)| {
        let mut set = whole.clone();
        change(&mut set);
        set
    };
    let silent = changed(&|set| {
        if let Reading::Cartesian { covariance, .. } = &mut set.observations[4].reading {
            *covariance = None;
        }
    });
    assert!(of(&silent, &[], &[]).contains("pose 3: the planned reading states no covariance"));
    let short = changed(&|set| _ = set.observations[0].command.pop());
    assert!(of(&short, &[], &[]).contains("pose 1: 3 commands, but the robot has 4 joints"));
    let nan = changed(&|set| set.observations[0].command[0] = f64::NAN);
    assert!(of(&nan, &[], &[]).contains("pose 1: a command or reading is not a finite number"));
    let far = changed(&|set| set.observations[0].command[1] = 1.75);
    let text = of(&far, &[], &[]);
    assert!(
        text.contains("candidate pose 1: joint 2 is at 1.750000, beyond its limits -1.5 to 1.5 by 0.250000"),
        "{text}"
    );
    // The limits do not apply to a pose that was already measured.
    assert!(PlannedSession::new(&model, &far, &options, None, &[1], &[]).is_ok());
    let singular = changed(&|set| {
        if let Reading::Cartesian { covariance, .. } = &mut set.observations[4].reading {
            *covariance = Some(Matrix3::zeros());
        }
    });
    assert!(of(&singular, &[], &[]).contains("pose 3: the covariance is not positive definite"));

    let region = |command: &[f64]| of(&whole, &[], &[PoseQuery::at(&[0.0; 4]), PoseQuery::at(command)]);
    assert!(region(&[0.0; 3]).contains("pose 2 of the region: command has 3 entries"));
    assert!(region(&[0.0, f64::NAN, 0.0, 0.0]).contains("pose 2 of the region: command"));
    assert!(region(&[0.0, 0.0, 2.5, 0.0]).contains("pose 2 of the region: joint 3 is at 2.5"));
    let target = PoseQuery::at(&[0.0; 4]).with_target(2);
    assert!(of(&whole, &[], &[target]).contains("target index 2: the robot has 2 targets"));
    let approach = PoseQuery::at(&[0.0; 4]).approached(&[1]);
    assert!(of(&whole, &[], &[approach]).contains("approach has 1 entries"));
}

#[test]
fn boxes_that_cannot_be() {
    let model = arm();
    let of = |region: &[[f64; 2]], count| {
        candidate_commands(&model, region, count).expect_err("refused").to_string()
    };
    assert!(of(&LIMITS[..3], 5).contains("the box of joint variables: 3 entries, expected 4"));
    assert!(of(&LIMITS, 0).contains("there is no candidate pose"));
    let mut region = LIMITS;
    region[2] = [0.0, 2.1];
    assert!(of(&region, 5).contains("the upper end of the box: joint 3 is at 2.1"));
    region[2] = [1.0, 0.5];
    assert!(of(&region, 5).contains("width of the box at a joint is -0.5"));
    region[2] = [f64::NAN, 0.5];
    assert!(of(&region, 5).contains("an end of the box at joint 3 is not a finite number"));
    region[2] = [0.5, 0.5];
    let fixed = candidate_commands(&model, &region, 50).expect("candidates");
    assert!(fixed.iter().all(|command| command[2] == 0.5));
    // The box is filled, both halves of every joint equally; a sixth of the candidates is at either end of each.
    let full = candidate_commands(&model, &LIMITS, 600).expect("candidates");
    for (joint, [low, high]) in LIMITS.iter().enumerate() {
        let of = |is: &dyn Fn(f64) -> bool| full.iter().filter(|command| is(command[joint])).count();
        let counts = [of(&|q| q < 0.5 * (low + high)), of(&|q| q == *low), of(&|q| q == *high)];
        assert!(
            (285..=315).contains(&counts[0]) && counts[1..].iter().all(|n| (45..=55).contains(n)),
            "{counts:?}"
        );
        assert!(full.iter().all(|command| command[joint] >= *low && command[joint] <= *high));
    }
}
