//! Among several places in one row, the one that the tracker saw; a controller writes its own next to its orientation.

use super::column::{Role, SeenColumn};
use super::names::{beside_axis, words};

/// Words of the names that programs and people give to what a tracker saw.
const TRACKER: [&str; 30] = [
    "lt",
    "tracker",
    "lasertracker",
    "laser",
    "track",
    "meas",
    "measured",
    "measurement",
    "smr",
    "reflector",
    "at",
    "leica",
    "faro",
    "api",
    "radian",
    "vantage",
    "mess",
    "messung",
    "gemessen",
    "observed",
    "obs",
    "tmac",
    "tprobe",
    "probe",
    "rigidbody",
    "mocap",
    "optitrack",
    "vicon",
    "qualisys",
    "camera",
];
/// Words of the names of what a controller computes.
const CONTROLLER: [&str; 11] =
    ["tcp", "tool", "flange", "fk", "ee", "eef", "ctrl", "controller", "krc", "trans", "computed"];
/// Names of angles and quaternions as controllers write them behind a place.
const TURNS: [&[&str]; 16] = [
    &["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"],
    &["m11", "m12", "m13", "m21", "m22", "m23", "m31", "m32", "m33"],
    &["nx", "ny", "nz", "ox", "oy", "oz", "ax", "ay", "az"],
    &["w", "x", "y", "z"],
    &["q1", "q2", "q3", "q4"],
    &["q0", "q1", "q2", "q3"],
    &["qw", "qx", "qy", "qz"],
    &["qx", "qy", "qz", "qw"],
    &["a", "b", "c"],
    &["w", "p", "r"],
    &["o", "a", "t"],
    &["rx", "ry", "rz"],
    &["roll", "pitch", "yaw"],
    &["yaw", "pitch", "roll"],
    &["alpha", "beta", "gamma"],
    &["phi", "theta", "psi"],
];

/// Columns of an orientation, from the first to behind the last.
struct Turn {
    from: usize,
    to: usize,
    family: Vec<String>,
}

struct Triple {
    columns: [usize; 3],
    family: Vec<String>,
}

/// Keeps, of all columns named x, y and z, three that belong together, with the reason or the doubt.
pub(super) fn choose(columns: &mut [SeenColumn]) {
    let turns = turns(columns);
    for turn in &turns {
        for column in &mut columns[turn.from..turn.to] {
            column.role = None;
        }
    }
    let triples = triples(columns);
    if triples.is_empty() {
        return;
    }
    let ranked: Vec<_> = triples.iter().map(|triple| rank(columns, triple, &triples, &turns)).collect();
    let best = ranked.iter().map(|(rank, _)| *rank).max().unwrap_or(0);
    let of_best: Vec<usize> = (0..triples.len()).filter(|index| ranked[*index].0 == best).collect();
    let chosen = of_best[0];
    let is_spherical = |role| columns.iter().any(|column| column.role == Some(role));
    let is_spherical = is_spherical(Role::Range)
        && is_spherical(Role::Azimuth)
        && (is_spherical(Role::Elevation) || is_spherical(Role::Zenith));
    let numbers = |triple: &Triple| {
        let [x, y, z] = triple.columns.map(|index| columns[index].number);
        format!("{x}, {y}, {z}")
    };
    let doubt = if of_best.len() > 1 {
        let all: Vec<_> = of_best.iter().map(|index| numbers(&triples[*index])).collect();
        Some(format!(
            "columns {} could each be the position: which of them did the tracker see?",
            all.join(" and ")
        ))
    } else if best == 0 {
        let why = ranked[chosen].1.clone().unwrap_or_default();
        Some(format!(
            "{why}, as a controller reports its own computed tool position, which is not a measurement: did the tracker see \
             this?"
        ))
    } else {
        None
    };
    let others: Vec<String> = (0..triples.len())
        .filter(|index| *index != chosen)
        .filter_map(|index| {
            Some(format!("columns {} stand {}", numbers(&triples[index]), ranked[index].1.as_ref()?))
        })
        .collect();
    let keeps = !(best == 0 && is_spherical);
    if let Some(turn) = turn_of(&triples[chosen], &triples, &turns).filter(|_| keeps) {
        // A person must first decide whether the tracker saw this at all.
        let is_seen = doubt.is_none();
        for (order, column) in columns[turn.from..turn.to].iter_mut().enumerate() {
            (column.is_beside, column.order) = (true, order);
            if is_seen {
                let called = format!("called {:?}, next to the position", column.header);
                column.take(Role::Turn, order, called);
            }
        }
    }
    for (index, column) in columns.iter_mut().enumerate() {
        if !matches!(column.role, Some(Role::X | Role::Y | Role::Z)) {
            continue;
        }
        if !keeps || !triples[chosen].columns.contains(&index) {
            column.role = None;
            continue;
        }
        if doubt.is_none() && triples.len() > 1 {
            let named = if best == 2 { ", as a tracker's" } else { "" };
            column.reason = format!("{}{named}", column.reason);
            if column.role == Some(Role::X) && !others.is_empty() {
                column.reason =
                    format!("{}; {}, as a controller's own columns do", column.reason, others.join(", "));
            }
        }
        column.doubt.clone_from(&doubt);
    }
}

/// 2 where the name is a tracker's, 0 where it looks like the controller's own, with why.
fn rank(columns: &[SeenColumn], triple: &Triple, all: &[Triple], turns: &[Turn]) -> (u8, Option<String>) {
    let has = |word: &str| triple.family.iter().any(|own| own == word);
    let is_tracker = TRACKER.iter().any(|word| has(word));
    let last = triple.columns[2];
    let turn = turn_of(triple, all, turns);
    if is_tracker {
        return (2, None);
    }
    if let Some(turn) = turn {
        let names: Vec<_> = columns[turn.from..turn.to].iter().map(|column| column.header.as_str()).collect();
        return (0, Some(format!("beside {}", names.join(", "))));
    }
    if CONTROLLER.iter().any(|word| has(word)) || (has("pos") && has("act")) {
        return (0, Some(format!("under a controller's name ({})", columns[last].header)));
    }
    (1, None)
}

/// The orientation next to a place.
fn turn_of<'t>(triple: &Triple, all: &[Triple], turns: &'t [Turn]) -> Option<&'t Turn> {
    let touches = |triple: &Triple, turn: &Turn| turn.from == triple.columns[2] + 1;
    turns.iter().find(|turn| touches(triple, turn)).or_else(|| {
        // An orientation elsewhere belongs to the place of the same name, or to the only one.
        turns
            .iter()
            .filter(|turn| !all.iter().any(|triple| touches(triple, turn)))
            .find(|turn| turn.family == triple.family || all.len() == 1 || turn.to == triple.columns[0])
    })
}

/// X, Y and Z of one name, in the order of the file; where names are repeated, the first with the first.
fn triples(columns: &[SeenColumn]) -> Vec<Triple> {
    let mut families: Vec<(Vec<String>, [Vec<usize>; 3])> = Vec::new();
    for (index, column) in columns.iter().enumerate() {
        let axis = match column.role {
            Some(Role::X) => 0,
            Some(Role::Y) => 1,
            Some(Role::Z) => 2,
            _ => continue,
        };
        let family = beside_axis(column.said_name());
        let at = families.iter().position(|(known, _)| *known == family).unwrap_or_else(|| {
            families.push((family, Default::default()));
            families.len() - 1
        });
        families[at].1[axis].push(index);
    }
    let mut triples: Vec<Triple> = families
        .into_iter()
        .flat_map(|(family, [x, y, z])| {
            let all = x.into_iter().zip(y).zip(z);
            all.map(move |((x, y), z)| Triple { columns: [x, y, z], family: family.clone() })
                .collect::<Vec<_>>()
        })
        .collect();
    triples.sort_by_key(|triple| triple.columns[0]);
    triples
}

/// Orientations: columns side by side with the names of angles or of a quaternion.
fn turns(columns: &[SeenColumn]) -> Vec<Turn> {
    let names: Vec<Vec<String>> = columns.iter().map(|column| words(column.said_name())).collect();
    let is_of = |index: usize, wanted: &str| {
        columns[index].role != Some(Role::Joint)
            && columns[index].is_number()
            && (names[index].last().is_some_and(|word| word == wanted)
                || names[index].first().is_some_and(|word| word == wanted))
    };
    let is_named = |index: usize| {
        let words = ["orientation", "quaternion", "quat", "rotation"];
        columns[index].is_number() && names[index].iter().any(|word| words.contains(&word.as_str()))
    };
    let family = |index: usize, but: &str| -> Vec<String> {
        names[index].iter().filter(|word| *word != but).cloned().collect()
    };
    let (mut found, mut at) = (Vec::new(), 0);
    while at < columns.len() {
        let set = TURNS.iter().find(|set| {
            at + set.len() <= columns.len() && set.iter().enumerate().all(|(k, word)| is_of(at + k, word))
        });
        let named = (at..columns.len()).take_while(|index| is_named(*index)).count();
        let (length, family) = match set {
            Some(set) => (set.len(), family(at, set[0])),
            None if named >= 3 => (named, Vec::new()),
            None => {
                at += 1;
                continue;
            }
        };
        found.push(Turn { from: at, to: at + length, family });
        at += length;
    }
    found
}
