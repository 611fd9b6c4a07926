//! Which top-level module may see which: no inverse crime, and no sink imported upstream.
//!
//! Every `crate::` path of every file under `src/` is compared with [`ALLOWED`]; code behind `#[cfg(test)]` is left out. The table itself
//! is held to the rules below it, so that widening it cannot break them unnoticed.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

/// Every top-level module with all that it uses. An entry that is not used any more fails the test, too.
const ALLOWED: &[(&str, &[&str])] = &[
    (
        "cli",
        &[
            "evaluation",
            "identification",
            "input",
            "kinematics",
            "measurement",
            "model",
            "montecarlo",
            "pipeline",
            "random",
            "recording",
            "replay",
            "report",
            "scenario",
        ],
    ),
    ("elastostatics", &["geometry", "kinematics", "model"]),
    ("evaluation", &["statistics"]),
    ("experiment", &[]),
    ("geometry", &[]),
    ("identification", &["elastostatics", "geometry", "kinematics", "measurement", "model", "statistics"]),
    ("input", &[]),
    ("kinematics", &["geometry", "model"]),
    ("main", &["cli"]),
    ("measurement", &["geometry", "input", "model"]),
    ("model", &["geometry", "input"]),
    (
        "montecarlo",
        &["evaluation", "identification", "measurement", "model", "pipeline", "scenario", "statistics"],
    ),
    (
        "pipeline",
        &[
            "elastostatics",
            "evaluation",
            "geometry",
            "identification",
            "input",
            "measurement",
            "model",
            "plant",
            "random",
            "scenario",
            "tracker",
            "validation",
        ],
    ),
    ("plant", &["geometry", "model"]),
    ("random", &[]),
    (
        "recording",
        &[
            "evaluation",
            "geometry",
            "identification",
            "input",
            "kinematics",
            "measurement",
            "model",
            "pipeline",
            "plant",
        ],
    ),
    ("replay", &["identification", "input", "model", "pipeline", "recording", "scenario"]),
    ("report", &["evaluation", "identification", "measurement", "model", "pipeline", "statistics"]),
    (
        "scenario",
        &["experiment", "identification", "input", "measurement", "model", "plant", "random", "tracker"],
    ),
    ("statistics", &[]),
    ("tracker", &["geometry", "measurement"]),
    ("validation", &["evaluation", "measurement"]),
];

/// Modules that estimate, and the ones that they see through.
const ESTIMATORS: &[&str] = &["identification", "kinematics", "elastostatics", "measurement", "model"];
/// What must stay out of their sight: the truth, and all that carries it.
const TRUTH: &[&str] = &["plant", "tracker", "scenario", "pipeline", "experiment"];
/// What must not be used to make the truth: data simulated with the estimator's own model would fit too well.
const MODEL: &[&str] = &["identification", "kinematics", "elastostatics"];
/// Sinks, each with the only modules that may use it.
const SINKS: &[(&str, &[&str])] =
    &[("recording", &["cli", "replay"]), ("report", &["cli"]), ("cli", &["main"])];

#[test]
fn modules_see_only_what_the_table_allows() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let sources = read_sources(&src);
    assert!(sources.len() > 20, "only {} files under {}", sources.len(), src.display());
    let complaints = check(&sources, ALLOWED);
    assert!(complaints.is_empty(), "\n{}", lines(&complaints));
}

#[test]
fn neither_side_of_the_measurements_reaches_the_other() {
    for (modules, hidden) in [(ESTIMATORS, TRUTH), (&["plant", "tracker"], MODEL)] {
        for module in modules {
            let reached = reachable(module, ALLOWED);
            let seen: Vec<_> = hidden.iter().filter(|other| reached.contains(**other)).collect();
            assert!(seen.is_empty(), "the table lets {module} reach {seen:?}");
        }
    }
}

#[test]
fn nothing_upstream_imports_a_sink() {
    for (sink, users) in SINKS {
        for (module, uses) in ALLOWED {
            assert!(!uses.contains(sink) || users.contains(module), "the table lets {module} use {sink}");
        }
    }
}

/// A file below `src/`: its path there, and its text.
type SourceFile = (PathBuf, String);
type Table<'a> = &'a [(&'a str, &'a [&'a str])];

#[derive(Debug, Clone, PartialEq, Eq)]
enum Complaint {
    /// A path to a module that the table does not allow.
    Forbidden { file: PathBuf, line: usize, from: String, to: String },
    /// A path to the crate's root that does not begin with a module's name: the table would not see what it leads to.
    Unclear { file: PathBuf, line: usize, path: String },
    /// A module that the table lacks, or a row without a module.
    Row { module: String, exists: bool },
    /// An allowed edge that no file uses.
    Unused { from: String, to: String },
}

impl fmt::Display for Complaint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Forbidden { file, line, from, to } => {
                write!(f, "src/{}:{line}: {from} must not see {to}", file.display())
            }
            Self::Unclear { file, line, path } => {
                write!(f, "src/{}:{line}: write `crate::module::...` instead of `{path}`", file.display())
            }
            Self::Row { module, exists: true } => write!(f, "module {module} has no row in the table"),
            Self::Row { module, exists: false } => write!(f, "the table's row {module} has no module"),
            Self::Unused { from, to } => write!(f, "the table allows {from} to see {to}, which no file does"),
        }
    }
}

fn lines(complaints: &[Complaint]) -> String {
    complaints.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

fn reachable<'a>(module: &'a str, table: Table<'a>) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut next = vec![module];
    while let Some(module) = next.pop() {
        let uses = table.iter().filter(|(from, _)| *from == module).flat_map(|(_, uses)| *uses);
        next.extend(uses.filter(|to| reached.insert(**to)));
    }
    reached
}

fn read_sources(src: &Path) -> Vec<SourceFile> {
    let mut sources = Vec::new();
    let mut folders = vec![src.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of the sources") {
            let path = entry.expect("an entry of the folder").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = fs::read_to_string(&path).expect("a source file in UTF-8");
                sources.push((path.strip_prefix(src).expect("below src").to_path_buf(), text));
            }
        }
    }
    sources.sort();
    sources
}

/// Names of the modules from the crate's root to the one that a file holds; empty for `lib.rs`.
fn module_path(file: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        file.with_extension("").iter().map(|n| n.to_string_lossy().into_owned()).collect();
    if names.len() > 1 && names.last().is_some_and(|n| n == "mod") || names == ["lib"] {
        names.pop();
    }
    names
}

fn check(sources: &[SourceFile], table: Table) -> Vec<Complaint> {
    let files: Vec<_> = sources.iter().map(|(file, text)| (file, module_path(file), scan(text))).collect();
    let test_only: Vec<Vec<String>> = files
        .iter()
        .flat_map(|(_, module, scanned)| {
            scanned.test_modules.iter().map(|name| [module.as_slice(), std::slice::from_ref(name)].concat())
        })
        .collect();
    let modules: BTreeSet<&str> =
        files.iter().filter_map(|(_, module, _)| module.first()).map(String::as_str).collect();
    let allowed: BTreeMap<_, _> = table.iter().copied().collect();
    let mut complaints = Vec::new();
    let mut used = BTreeSet::new();
    for (file, module, scanned) in &files {
        // lib.rs holds no code of its own: what it re-exports is reached under the crate's name, and refused there.
        let Some(from) = module.first() else { continue };
        if test_only.iter().any(|t| module.starts_with(t)) {
            continue;
        }
        for path in &scanned.paths {
            let (file, line) = ((*file).clone(), path.line);
            match path.leads_to(module.len()) {
                Target::Inside => {}
                Target::Module(to) if from == to => {}
                Target::Module(to) if modules.contains(to) => {
                    let (from, to) = (from.clone(), to.to_owned());
                    if allowed.get(from.as_str()).is_some_and(|uses| uses.contains(&to.as_str())) {
                        used.insert((from, to));
                    } else {
                        complaints.push(Complaint::Forbidden { file, line, from, to });
                    }
                }
                Target::Module(_) | Target::Root => {
                    complaints.push(Complaint::Unclear { file, line, path: path.to_string() });
                }
            }
        }
    }
    let rows: BTreeSet<&str> = table.iter().map(|(module, _)| *module).collect();
    for module in modules.symmetric_difference(&rows) {
        complaints.push(Complaint::Row { module: (*module).to_owned(), exists: modules.contains(module) });
    }
    for (from, uses) in table {
        for to in *uses {
            let edge = ((*from).to_owned(), (*to).to_owned());
            if !used.contains(&edge) {
                complaints.push(Complaint::Unused { from: edge.0, to: edge.1 });
            }
        }
    }
    complaints
}

/// A path that may leave its top-level module: it begins with `crate`, `calibrig` or `super`.
#[derive(Debug, Clone, PartialEq, Eq)]
struct PathUse {
    line: usize,
    /// Names in order; `*` for all.
    names: Vec<String>,
}

enum Target<'a> {
    Inside,
    Module(&'a str),
    Root,
}

impl PathUse {
    /// `depth`: number of modules from the root to the file's own.
    fn leads_to(&self, depth: usize) -> Target<'_> {
        let after = if self.names[0] == "super" {
            let supers = self.names.iter().take_while(|n| *n == "super").count();
            if supers < depth {
                return Target::Inside;
            }
            supers
        } else {
            1
        };
        match self.names.get(after).map(String::as_str) {
            None | Some("*" | "self") => Target::Root,
            Some(name) => Target::Module(name),
        }
    }
}

impl fmt::Display for PathUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.names.join("::"))
    }
}

#[derive(Debug, Default, PartialEq, Eq)]
struct Scanned {
    paths: Vec<PathUse>,
    /// Names of the modules declared as `#[cfg(test)] mod name;`.
    test_modules: Vec<String>,
}

/// Paths and test modules of a text, without its comments, strings and `#[cfg(test)]` items.
fn scan(text: &str) -> Scanned {
    let tokens = tokens(text);
    let mut scanned = Scanned::default();
    let mut at = 0;
    while let Some(token) = tokens.get(at) {
        if begins(&tokens[at..], &["#", "[", "cfg", "(", "test", ")", "]"]) {
            let (name, end) = skip_item(&tokens, at + 7);
            scanned.test_modules.extend(name);
            at = end;
            continue;
        }
        let root = matches!(token.text, "crate" | "calibrig" | "super");
        if root && begins(&tokens[at + 1..], &[":", ":"]) {
            at = read_path(&tokens, at, &[], &mut scanned.paths);
        } else {
            if root && token.text == "crate" && tokens.get(at + 1).is_none_or(|t| t.text != ")") {
                // `use crate as ...`; `pub(crate)` is none.
                scanned.paths.push(PathUse { line: token.line, names: vec!["crate".to_owned()] });
            }
            at += 1;
        }
    }
    scanned
}

/// Reads a path, or all paths of a group in braces, behind `before`; returns the place behind it.
fn read_path(tokens: &[Token], mut at: usize, before: &[String], paths: &mut Vec<PathUse>) -> usize {
    let mut names = before.to_vec();
    let line = tokens.get(at).map_or(0, |t| t.line);
    while let Some(token) = tokens.get(at) {
        if token.text == "{" {
            at += 1;
            while tokens.get(at).is_some_and(|t| t.text != "}") {
                let start = at;
                at = read_path(tokens, at, &names, paths);
                // `as name` and the comma.
                while tokens.get(at).is_some_and(|t| t.text != "}" && t.text != ",") {
                    at += 1;
                }
                at += usize::from(tokens.get(at).is_some_and(|t| t.text == ","));
                assert!(at > start, "line {}: not a path", tokens[start].line);
            }
            return at + 1;
        }
        names.push(token.text.to_owned());
        at += 1;
        if !begins(&tokens[at..], &[":", ":"]) {
            break;
        }
        at += 2;
        // A turbofish ends what is of interest.
        if tokens.get(at).is_some_and(|t| t.text == "<") {
            break;
        }
    }
    paths.push(PathUse { line, names });
    at
}

/// The end of the item that begins at `at`, and its name if it is a module in a file of its own.
fn skip_item(tokens: &[Token], mut at: usize) -> (Option<String>, usize) {
    let mut depth = 0_usize;
    let mut seen_mod = None;
    while let Some(token) = tokens.get(at) {
        at += 1;
        match token.text {
            "mod" if depth == 0 => seen_mod = tokens.get(at).map(|t| t.text.to_owned()),
            "(" | "[" | "{" => depth += 1,
            ")" | "]" => depth = depth.saturating_sub(1),
            "}" => {
                depth = depth.saturating_sub(1);
                if depth == 0 {
                    return (None, at);
                }
            }
            ";" if depth == 0 => return (seen_mod, at),
            // A field or variant.
            "," if depth == 0 => return (None, at),
            _ => {}
        }
    }
    (None, at)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Token<'a> {
    text: &'a str,
    line: usize,
}

fn begins(tokens: &[Token], texts: &[&str]) -> bool {
    tokens.len() >= texts.len() && tokens.iter().zip(texts).all(|(token, text)| token.text == *text)
}

/// Names and single punctuation marks, without comments, characters, numbers, and strings that are no path.
fn tokens(text: &str) -> Vec<Token<'_>> {
    let mut tokens = Vec::new();
    let (mut at, mut line) = (0, 1);
    while let Some(first) = text[at..].chars().next() {
        let rest = &text[at..];
        let length = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            block_comment(rest)
        } else if let Some(length) = string(rest) {
            tokens.extend(path_in_attribute(&rest[..length], line));
            length
        } else if first == '\'' {
            character_or_lifetime(rest)
        } else if first.is_alphanumeric() || first == '_' {
            let length = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
            if !first.is_ascii_digit() {
                tokens.push(Token { text: &rest[..length], line });
            }
            length
        } else {
            let length = first.len_utf8();
            if !first.is_whitespace() {
                tokens.push(Token { text: &rest[..length], line });
            }
            length
        };
        line += rest[..length].matches('\n').count();
        at += length;
    }
    tokens
}

/// The tokens of a string that holds a path and nothing else, as in `#[serde(with = "crate::module")]`.
fn path_in_attribute(literal: &str, line: usize) -> Vec<Token<'_>> {
    let text = literal.trim_matches('"');
    let is_path = text.starts_with("crate::") || text.starts_with("super::");
    if is_path && text.chars().all(|c| c.is_alphanumeric() || c == '_' || c == ':') {
        tokens(text).into_iter().map(|token| Token { line, ..token }).collect()
    } else {
        Vec::new()
    }
}

fn block_comment(rest: &str) -> usize {
    let (mut depth, mut at) = (0, 0);
    while at < rest.len() {
        if rest[at..].starts_with("/*") {
            depth += 1;
            at += 2;
        } else if rest[at..].starts_with("*/") {
            depth -= 1;
            at += 2;
            if depth == 0 {
                return at;
            }
        } else {
            at += rest[at..].chars().next().map_or(1, char::len_utf8);
        }
    }
    rest.len()
}

/// Length of a string literal, raw or not, at the start of `rest`.
fn string(rest: &str) -> Option<usize> {
    let unprefixed = ["br", "cr", "b", "c", "r", ""].into_iter().find_map(|prefix| {
        let body = rest.strip_prefix(prefix)?;
        let hashes = body.len() - body.trim_start_matches('#').len();
        let raw = prefix.ends_with('r');
        (body[hashes..].starts_with('"') && (raw || hashes == 0)).then_some((prefix.len(), hashes, raw))
    });
    let (prefix, hashes, raw) = unprefixed?;
    let open = prefix + hashes + 1;
    if raw {
        let close = format!("\"{}", "#".repeat(hashes));
        return Some(rest[open..].find(&close).map_or(rest.len(), |end| open + end + close.len()));
    }
    let mut escaped = false;
    for (place, c) in rest[open..].char_indices() {
        if c == '"' && !escaped {
            return Some(open + place + 1);
        }
        escaped = c == '\\' && !escaped;
    }
    Some(rest.len())
}

fn character_or_lifetime(rest: &str) -> usize {
    let mut chars = rest.char_indices().skip(1);
    match (chars.next(), chars.next()) {
        (Some((_, '\\')), Some((escaped, c))) => {
            let behind = escaped + c.len_utf8();
            rest[behind..].find('\'').map_or(rest.len(), |end| behind + end + 1)
        }
        (Some(_), Some((end, '\''))) => end + 1,
        // A lifetime: its name is read next, and is no path.
        _ => 1,
    }
}

/// The checker itself.
mod checker {
    use super::*;

    const TABLE: Table = &[("truth", &[]), ("solver", &["base"]), ("base", &[])];

    fn complaints_of(solver: &str) -> Vec<String> {
        let file = |path: &str, text: &str| (PathBuf::from(path), text.to_owned());
        let sources = [
            file("lib.rs", "pub mod base;\npub mod solver;\npub mod truth;\n"),
            file("base.rs", ""),
            file("truth/mod.rs", "mod inner;\n"),
            file("truth/inner.rs", "use super::*;\nuse super::inner::X;\n"),
            file("solver/mod.rs", "use crate::base::Thing;\nmod deep;\n#[cfg(test)]\nmod trials;\n"),
            file("solver/deep.rs", solver),
            file("solver/trials.rs", "use crate::truth::AsBuilt;\n"),
            file("solver/trials/more.rs", "use crate::truth::AsBuilt;\n"),
        ];
        check(&sources, TABLE).iter().map(ToString::to_string).collect()
    }

    #[test]
    fn finds_every_way_to_a_forbidden_module() {
        for (line, source) in [
            (1, "use crate::truth::AsBuilt;"),
            (2, "\nuse crate::{base::Thing, truth::AsBuilt};"),
            (3, "use crate::{\n    base,\n    truth as t,\n};"),
            (1, "use crate::{base::{A, B::{self, C}}, truth};"),
            (1, "pub(crate) use crate::truth::{AsBuilt};"),
            (2, "fn f() {\n    let x = crate::truth::peek(1.0 as f64);\n}"),
            (1, "fn f(x: &'static crate::truth::AsBuilt) -> char { 'a' }"),
            (1, "fn f() { Vec::<crate::truth::AsBuilt>::new(); }"),
            (1, "use super::super::truth::AsBuilt;"),
            (1, "use self::super::super::truth::AsBuilt;"),
            (1, "use calibrig::truth::AsBuilt;"),
            (1, "use ::calibrig::truth::AsBuilt;"),
            (2, "struct S {\n    #[serde(with = \"crate::truth\")]\n    a: f64,\n}"),
            (1, "macro_rules! peek { () => { $crate::truth::peek() } }"),
            (1, "#[cfg(not(test))] use crate::truth::AsBuilt;"),
            (1, "#[cfg(any(test, feature = \"x\"))] use crate::truth::AsBuilt;"),
            (2, "#[cfg(test)] use crate::truth::A;\nuse crate::truth::AsBuilt;"),
            (
                4,
                "#[cfg(test)]\n#[allow(unused)]\nmod tests { use crate::truth::A; fn f() {} }\nuse crate::truth::B;",
            ),
            (3, "/* a /* nested */ comment */ const A: &str = r#\"\n\"#;\nuse crate::truth::AsBuilt;"),
            (1, "const A: char = '\"'; use crate::truth::AsBuilt; const B: char = '\\'';"),
        ] {
            let expected = format!("src/solver/deep.rs:{line}: solver must not see truth");
            assert_eq!(complaints_of(source), [expected], "{source}");
        }
    }

    #[test]
    fn refuses_paths_that_hide_a_module() {
        for source in [
            "use crate::*;",
            "use crate::{self as root};",
            "use crate as root;",
            "use super::super::*;",
            "use crate::AsBuilt;",
        ] {
            let found = complaints_of(source);
            assert_eq!(found.len(), 1, "{source}: {found:?}");
            assert!(found[0].contains("src/solver/deep.rs:1: write `crate::module::...`"), "{found:?}");
        }
    }

    #[test]
    fn leaves_alone_what_is_no_use() {
        for source in [
            "",
            "use crate::base::Thing;",
            "use super::Other;",
            "use crate::solver::Other;",
            "use std::truth::crate_name; pub(crate) fn f() {}",
            "// use crate::truth::AsBuilt;\n/// [`crate::truth`]\n//! crate::truth\nfn f() {}",
            "/* use crate::truth::AsBuilt; /* */ crate::truth::f() */",
            "const A: &str = \"crate::truth::f \\\" crate::truth::g\"; const B: &[u8] = br##\"crate::truth \"# \"##;",
            "#[cfg(test)]\nmod tests {\n    use crate::truth::AsBuilt;\n}",
            "#[cfg(test)] use crate::truth::AsBuilt;",
            "#[cfg(test)] fn f() -> [crate::truth::AsBuilt; 3] { crate::truth::three() }",
            "struct S<'a> { a: &'a str, #[cfg(test)] b: crate::truth::AsBuilt, c: u8 }",
        ] {
            assert_eq!(complaints_of(source), [""; 0], "{source}");
        }
    }

    #[test]
    fn refuses_a_table_that_is_not_true() {
        let sources = [(PathBuf::from("a.rs"), String::new()), (PathBuf::from("b/mod.rs"), String::new())];
        let found = check(&sources, &[("a", &["b"]), ("gone", &[])]);
        assert_eq!(
            found,
            [
                Complaint::Row { module: "b".to_owned(), exists: true },
                Complaint::Row { module: "gone".to_owned(), exists: false },
                Complaint::Unused { from: "a".to_owned(), to: "b".to_owned() },
            ]
        );
    }

    #[test]
    fn follows_the_table_through_other_modules() {
        let table: Table = &[("a", &["b"]), ("b", &["c"]), ("c", &["b"]), ("d", &[])];
        assert_eq!(reachable("a", table), BTreeSet::from(["b", "c"]));
        assert!(reachable("d", table).is_empty());
    }
}
