//! Flags as numbers of the robot.

use calibrig_files::load_session;
use calibrig_model::geometry::Transform;
use calibrig_model::nalgebra::Rotation3;
use calibrig_model::{CalibrationModel, JointKind, Payload};

use super::super::CliError;
use super::{Args, Signs, three};
use crate::handover::EstimateFile;
use calibrig_estimation::inverse::{Circumstances, GoalError, Tool};

/// Numbers of a flag.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Numbers(pub Vec<f64>);

/// Numbers separated by commas, which may be infinite.
pub(super) fn numbers(text: &str) -> Result<Numbers, String> {
    let all: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    match all {
        Ok(all)
            if all.iter().all(|number| !number.is_nan() && (number.is_infinite() || number.abs() <= 1e9)) =>
        {
            Ok(Numbers(all))
        }
        _ => Err("expected numbers separated by commas, such as 0,-90,90".to_owned()),
    }
}

/// Lengths in mm, as m.
pub(super) fn lengths(text: &str) -> Result<Numbers, String> {
    let Numbers(all) = numbers(text)?;
    if all.iter().all(|mm| mm.is_finite()) {
        return Ok(Numbers(all.iter().map(|mm| 1e-3 * mm).collect()));
    }
    Err("expected finite numbers of mm separated by commas, such as 0,0,120".to_owned())
}

pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number <= 1e9 => Ok(number),
        _ => Err("expected a finite number above zero".to_owned()),
    }
}

pub(super) fn length(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(um) if (1e-5..=1e6).contains(&um) => Ok(um),
        _ => Err("expected a number of um, at least 0.00001".to_owned()),
    }
}

pub(super) fn signs(text: &str) -> Result<Signs, String> {
    let sign = |part: &str| match part.trim() {
        "-1" | "-" => Some(-1),
        "0" => Some(0),
        "1" | "+1" | "+" => Some(1),
        _ => None,
    };
    let all: Option<Vec<i8>> = text.split(',').map(sign).collect();
    all.map(Signs).ok_or_else(|| "expected -1, 0 or 1 for every actuator, separated by commas".to_owned())
}

/// One per commanded actuator, spread over all joints.
fn spread<T: Copy>(
    stated: &[T],
    model: &CalibrationModel,
    other: T,
    flag: &'static str,
    what: &str,
) -> Result<Vec<T>, CliError> {
    let links = &model.kinematics.links;
    let commanded: Vec<bool> = (0..links.len()).map(|joint| model.actuators.is_commanded(joint)).collect();
    let expected = commanded.iter().filter(|is| **is).count();
    if stated.len() != expected {
        let names = links.iter().zip(&commanded).filter(|(_, is)| **is);
        let names = names.map(|(link, _)| {
            let unit = if link.kind == JointKind::Revolute { "deg" } else { "mm" };
            format!("{} ({unit})", link.name)
        });
        return Err(CliError::Flag {
            flag,
            message: format!("has {} numbers, but the robot has {expected} actuators", stated.len()),
            expected: format!("{what} of {}", names.collect::<Vec<_>>().join(", ")),
        });
    }
    let mut stated = stated.iter().copied();
    Ok(commanded.iter().map(|is| if *is { stated.next().unwrap_or(other) } else { other }).collect())
}

/// Numbers in mm and deg, converted to m and rad.
fn in_si(values: Vec<f64>, model: &CalibrationModel) -> Vec<f64> {
    let one = |(value, link): (f64, &calibrig_model::CraigLink)| match link.kind {
        JointKind::Revolute => value.to_radians(),
        JointKind::Prismatic => 1e-3 * value,
    };
    values.into_iter().zip(&model.kinematics.links).map(one).collect()
}

/// A command in mm and deg.
pub(super) fn command(
    stated: &Numbers,
    model: &CalibrationModel,
    flag: &'static str,
) -> Result<Vec<f64>, CliError> {
    if let Some(number) = stated.0.iter().find(|number| !number.is_finite()) {
        return Err(CliError::Flag {
            flag,
            message: format!("holds {number}"),
            expected: "finite numbers of mm and deg".to_owned(),
        });
    }
    Ok(in_si(spread(&stated.0, model, 0.0, flag, "a command")?, model))
}

/// Speed limits in mm/s and deg/s.
pub(super) fn speeds(stated: &Numbers, model: &CalibrationModel) -> Result<Vec<f64>, CliError> {
    if let Some(number) = stated.0.iter().find(|number| !(**number > 0.0)) {
        return Err(CliError::Flag {
            flag: "speed-limits",
            message: format!("holds {number}"),
            expected: "speeds above zero, inf for no limit".to_owned(),
        });
    }
    Ok(in_si(spread(&stated.0, model, f64::INFINITY, "speed-limits", "one speed per actuator")?, model))
}

/// The part of the robot that goals place, and its name.
pub(super) fn tool(args: &Args, file: &EstimateFile) -> Result<(Tool, String), CliError> {
    let robot = &file.estimate.robot;
    let of_flag = |flag: &'static str| {
        move |error: GoalError| CliError::Flag {
            flag,
            message: format!("cannot be: {error}"),
            expected: "finite numbers, of an axis not all zero".to_owned(),
        }
    };
    let (tool, name) = if let Some(stated) = &args.tool_mm {
        (Tool::at(three(stated, "tool-mm")?).map_err(of_flag("tool-mm"))?, "as stated".to_owned())
    } else {
        let index = match &args.tool {
            None => 0,
            Some(wanted) => {
                let found = file.targets.iter().position(|name| name == wanted);
                found.ok_or_else(|| CliError::Flag {
                    flag: "tool",
                    message: format!("is {wanted:?}, which is not a target of the estimate"),
                    expected: format!("one of {}, or --tool-mm", file.targets.join(", ")),
                })?
            }
        };
        let in_flange = robot.targets.get(index).copied().unwrap_or_default();
        let rotation = robot.orientations.get(index).copied().flatten().unwrap_or_else(Rotation3::identity);
        let placed = Tool::new(Transform::from_parts(in_flange.into(), rotation)).map_err(of_flag("tool"))?;
        (placed, file.targets.get(index).cloned().unwrap_or_default())
    };
    match &args.tool_axis {
        None => Ok((tool, name)),
        Some(axis) => {
            let directed = tool.with_axis(three(axis, "tool-axis")?).map_err(of_flag("tool-axis"))?;
            Ok((directed, name))
        }
    }
}

/// Payload, temperature, time and approach.
pub(super) fn circumstances(args: &Args, model: &CalibrationModel) -> Result<Circumstances, CliError> {
    let payload = match (&args.session, args.payload_kg, &args.payload_centre_mm) {
        (Some(session), ..) => Some(of_session(session, args.payload.as_deref())?),
        (None, Some(mass), Some(centre)) => {
            Some(Payload::of_mass(format!("{mass} kg"), mass, three(centre, "payload-centre-mm")?))
        }
        _ => None,
    };
    for (flag, value) in [("temperature-c", args.temperature_c), ("time-s", Some(args.time_s))] {
        if let Some(value) = value.filter(|value| !value.is_finite()) {
            return Err(CliError::Flag {
                flag,
                message: format!("is {value}"),
                expected: "a finite number".to_owned(),
            });
        }
    }
    let approach = match &args.approach {
        Some(Signs(stated)) => spread(stated, model, 0, "approach", "the sign of the last motion")?,
        None => Vec::new(),
    };
    Ok(Circumstances {
        payload,
        temperature: args.temperature_c,
        time: args.time_s,
        approach,
        since_reversal: Vec::new(),
    })
}

fn of_session(path: &std::path::Path, name: Option<&str>) -> Result<Payload, CliError> {
    let (session, _) = load_session(path)?;
    let known: Vec<&Payload> = session.payloads().collect();
    let names = || known.iter().map(|payload| format!("{:?}", payload.name)).collect::<Vec<_>>().join(", ");
    let refused = |flag, message, expected| Err(CliError::Flag { flag, message, expected });
    match (name, known.as_slice()) {
        (_, []) => refused(
            "session",
            format!("{} states no payload", path.display()),
            "a [[payload]] with name, mass_kg, x_mm, y_mm and z_mm; or --payload-kg and --payload-centre-mm"
                .to_owned(),
        ),
        (None, [only]) => Ok((*only).clone()),
        (None, _) => refused(
            "session",
            format!("{} states several payloads", path.display()),
            format!("--payload with one of {}", names()),
        ),
        (Some(name), _) => match known.iter().find(|payload| payload.name == name) {
            Some(payload) => Ok((*payload).clone()),
            None => refused(
                "payload",
                format!("is {name:?}, but {} states no such payload", path.display()),
                format!("one of {}", names()),
            ),
        },
    }
}
