//! What the compiler does not say of our walls: which of our crates may depend on which, what the estimator may bring along, and which
//! modules of the root are sinks. That a crate cannot name what it does not depend on, the compiler says.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use toml::Table;

/// Every crate of ours, with all of ours that it depends on.
const CRATES: [(&str, &[&str]); 7] = [
    // What both sides may know names neither.
    ("calibrig-model", &[]),
    // Nothing that estimates reaches the truth, nor what carries it.
    ("calibrig-estimation", &["calibrig-model"]),
    // Nothing of the truth is made with the estimator's model: simulated data would fit too well.
    ("calibrig-plant", &["calibrig-model"]),
    // Files hold what is stated and measured; what is made of it is not their business.
    ("calibrig-files", &["calibrig-model"]),
    // Studies of many trials know nothing of robots.
    ("calibrig-campaign", &["calibrig-model"]),
    // Shows the truth beside the estimate, as the root does; makes neither.
    ("calibrig-recording", &["calibrig-estimation", "calibrig-files", "calibrig-model", "calibrig-plant"]),
    // The root alone joins them.
    (
        "calibrig",
        &[
            "calibrig-campaign",
            "calibrig-estimation",
            "calibrig-files",
            "calibrig-model",
            "calibrig-plant",
            "calibrig-recording",
        ],
    ),
];
/// What tests depend on beside: the estimator's are fed with the robots in `models/`.
const OF_TESTS: [(&str, &[&str]); 1] = [("calibrig-estimation", &["calibrig-files"])];

/// What must not come with the estimator, however deep: the simulation, and all that reads, writes, draws or talks.
const NOT_OF_THE_ESTIMATOR: [&str; 11] = [
    "rapier3d-f64",
    "parry3d-f64",
    "clap",
    "csv",
    "indicatif",
    "mcap",
    "miette",
    "plotters",
    "rayon",
    "rerun",
    "toml",
];
const MOST_PACKAGES_OF_THE_ESTIMATOR: usize = 80;

/// Every module of the root with the others that it uses, and whether it looks at the truth (`calibrig_plant`) or a recording.
///
/// A recording is made by `cli` and read by `replay`; of `pipeline` it takes what it is told (`Story`). What is handed over names the program as a recording
/// does, and looks at nothing else of it. `report` is used by `cli`, `cli` by
/// `main`; a scenario knows nothing of what is made of it.
const MODULES: [(&str, &[&str]); 11] = [
    (
        "cli",
        &[
            "calibrig_recording",
            "compensate",
            "handover",
            "montecarlo",
            "pipeline",
            "pose_plan",
            "replay",
            "report",
            "scenario",
            "twin",
        ],
    ),
    ("compensate", &["handover"]),
    ("handover", &["calibrig_recording", "pipeline"]),
    ("main", &["cli"]),
    ("montecarlo", &["pipeline", "scenario"]),
    ("pipeline", &["calibrig_plant", "calibrig_recording", "scenario"]),
    ("pose_plan", &["calibrig_plant", "pipeline", "scenario"]),
    ("replay", &["calibrig_recording", "pipeline", "scenario"]),
    ("report", &["compensate", "montecarlo", "pipeline", "pose_plan"]),
    ("scenario", &["calibrig_plant"]),
    ("twin", &["calibrig_plant", "scenario"]),
];

type Edges = BTreeMap<String, BTreeSet<String>>;

fn edges(stated: &[(&str, &[&str])]) -> Edges {
    stated.iter().map(|(from, to)| (from.to_string(), to.iter().map(ToString::to_string).collect())).collect()
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read_toml(path: &Path) -> Table {
    fs::read_to_string(path).expect("a file of the repository").parse().expect("TOML")
}

/// The manifests of the workspace by the names of their packages.
fn manifests() -> BTreeMap<String, Table> {
    let crates = fs::read_dir(root().join("crates")).expect("the crates").map(|e| e.expect("a crate").path());
    let folders = crates.chain([root().to_path_buf()]);
    let manifests = folders.map(|folder| read_toml(&folder.join("Cargo.toml")));
    manifests.map(|m| (m["package"]["name"].as_str().expect("a name").to_owned(), m)).collect()
}

/// The packages that a manifest names in tables of these kinds, for any target, by their own names.
fn dependencies(manifest: &Table, kinds: &[&str]) -> BTreeSet<String> {
    let workspace = read_toml(&root().join("Cargo.toml"));
    let targets = manifest.get("target").and_then(|t| t.as_table()).into_iter().flatten();
    let tables = targets.filter_map(|(_, table)| table.as_table()).chain([manifest]);
    tables
        .flat_map(|table| kinds.iter().filter_map(|kind| table.get(*kind)?.as_table()))
        .flatten()
        .map(|(key, entry)| {
            let shared = || workspace["workspace"]["dependencies"].get(key)?.get("package");
            let renamed = entry.get("package").or_else(shared).and_then(|name| name.as_str());
            renamed.unwrap_or(key).to_owned()
        })
        .collect()
}

/// Our own crates among the dependencies of each.
fn own(manifests: &BTreeMap<String, Table>, kinds: &[&str]) -> Edges {
    let ours = |m| dependencies(m, kinds).into_iter().filter(|d| manifests.contains_key(d)).collect();
    manifests.iter().map(|(name, manifest)| (name.clone(), ours(manifest))).collect()
}

#[test]
fn no_crate_depends_on_one_that_it_must_not_see() {
    let manifests = manifests();
    assert_eq!(own(&manifests, &["dependencies", "build-dependencies"]), edges(&CRATES));
    let mut of_tests = own(&manifests, &["dev-dependencies"]);
    of_tests.retain(|_, to| !to.is_empty());
    assert_eq!(of_tests, edges(&OF_TESTS));
}

/// By `Cargo.lock`, which holds every feature and target that the workspace may switch on: no less than what is built.
#[test]
fn the_estimator_brings_little_along() {
    let (manifests, lock) = (manifests(), read_toml(&root().join("Cargo.lock")));
    let packages = lock["package"].as_array().expect("packages");
    let mut next: Vec<&str> = vec!["calibrig-estimation"];
    let mut reached = BTreeSet::new();
    while let Some(wanted) = next.pop() {
        // "name", or "name version" where there are several.
        let (name, version) = wanted.split_once(' ').unwrap_or((wanted, ""));
        let here = |p: &&toml::Value| {
            p["name"].as_str() == Some(name) && p["version"].as_str().is_some_and(|v| v.starts_with(version))
        };
        let package = packages.iter().find(here).expect("a locked package");
        if !reached.insert((name, package["version"].as_str())) {
            continue;
        }
        // The lock does not tell our tests' dependencies from the others.
        let normal = manifests.get(name).map(|m| dependencies(m, &["dependencies", "build-dependencies"]));
        let dependencies = package.get("dependencies").and_then(|d| d.as_array()).into_iter().flatten();
        let all = dependencies.filter_map(|d| d.as_str());
        next.extend(
            all.filter(|d| normal.as_ref().is_none_or(|n| n.contains(d.split(' ').next().unwrap_or(d)))),
        );
    }
    let names: BTreeSet<&str> = reached.iter().map(|(name, _)| *name).collect();
    eprintln!("{} packages behind the estimator at most", reached.len());
    assert!(names.contains("nalgebra"), "not read as meant: {names:?}");
    assert!(names.is_disjoint(&NOT_OF_THE_ESTIMATOR.into()), "{names:?}");
    assert!(reached.len() <= MOST_PACKAGES_OF_THE_ESTIMATOR, "{}: {names:?}", reached.len());
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder of the sources").map(|e| e.expect("an entry").path());
    let below = entries.flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] });
    below.filter(|path| path.extension().is_some_and(|e| e == "rs")).collect()
}

/// The lines of a formatted file, without comments and items behind `#[cfg(test)]`.
fn code(text: &str) -> Vec<&str> {
    let mut code = Vec::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if let Some(indent) = line.strip_suffix("#[cfg(test)]") {
            let ends = |l: &str| {
                l.strip_prefix(indent).is_some_and(|l| l == "}" || !l.starts_with(' ') && l.ends_with(';'))
            };
            lines.find(|l| ends(l)).expect("the end of an item");
        } else {
            code.push(line.split("//").next().unwrap_or(line));
        }
    }
    code
}

#[test]
fn sinks_are_used_by_none_but_those_that_drive_them() {
    let src = root().join("src");
    let mut found = Edges::new();
    for file in sources(&src) {
        let below = file.strip_prefix(&src).expect("below src").with_extension("");
        let module = below.iter().next().expect("a module").to_string_lossy().into_owned();
        // lib.rs is the facade; tests, and what they are made of, may compare anything.
        if module == "lib" || ["tests", "sample"].iter().any(|of_tests| below.ends_with(of_tests)) {
            continue;
        }
        let uses = found.entry(module.clone()).or_default();
        // How often `super` leads to the root.
        let depth = below.iter().filter(|name| *name != "mod").count();
        for line in code(&fs::read_to_string(&file).expect("UTF-8")) {
            for path in line.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')) {
                let names: Vec<&str> = path.split("::").collect();
                let after = match names[0] {
                    "crate" | "calibrig" if names.len() > 1 => 1,
                    "super" if names.iter().take_while(|name| **name == "super").count() == depth => depth,
                    "calibrig_plant" | "calibrig_recording" => 0,
                    _ => continue,
                };
                let to = names.get(after).filter(|to| !to.is_empty());
                let to =
                    to.unwrap_or_else(|| panic!("{}: a path that tells no module: {line}", file.display()));
                uses.extend((*to != module).then(|| (*to).to_owned()));
            }
        }
    }
    assert_eq!(found, edges(&MODULES));
}
