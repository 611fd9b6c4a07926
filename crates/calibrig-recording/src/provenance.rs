//! Where a recording comes from: its metadata, its input files, and a hash over both.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::Path;
use std::str::FromStr;

use sha2::{Digest, Sha256};

use super::{InputSummary, RecordingError};
use calibrig_estimation::METHOD;
use calibrig_files::Source;
use calibrig_plant::session::PlantKind;

/// Name and version of the recording's layout: topics, messages and metadata.
pub const SCHEMA: &str = "calibrig.recording/2";
const SCHEMA_NAME: &str = "calibrig.recording/";
const SCHEMA_VERSION: u32 = 2;
/// Name of the metadata record.
pub(super) const METADATA: &str = "calibrig";
/// Name of the metadata record of a file that was saved from a damaged one.
pub(super) const RECOVERED: &str = "calibrig_recovered";
/// New name of a metadata record that does not fit its hash, in a file that was saved from a damaged one.
pub(super) const ALTERED: &str = "calibrig_altered";

/// Where a recording comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Provenance {
    /// Name and version of the program that wrote it.
    pub software: String,
    /// Number of the method that made its estimates ([`calibrig_estimation::METHOD`]); 1 if the recording does not state one.
    pub method: u32,
    /// `scenario`, `files` or `recording`.
    pub input_kind: String,
    /// Name of the input for people.
    pub input_name: String,
    /// Hash over every input file, hexadecimal.
    pub input_sha256: String,
    /// The seed of a simulation.
    pub seed: Option<u64>,
    /// Number of the simulation's trial, and the plant that stood for the machine; always `None` in schema 1.
    pub trial: Option<(u32, PlantKind)>,
    /// Hash over the recording's metadata and attachments, hexadecimal.
    pub provenance_sha256: String,
}

/// An input file as it is attached to the recording: `role/file name` and its text.
pub(super) type AttachedInput = (String, String);

/// The input files as attachments, named without folders: the same run gives the same bytes wherever its files are.
pub(super) fn attached_inputs(sources: &[(String, Source)]) -> Vec<AttachedInput> {
    sources
        .iter()
        .map(|(role, source)| {
            let file = Path::new(&source.name)
                .file_name()
                .map_or_else(|| source.name.clone(), |f| f.to_string_lossy().into_owned());
            (format!("{role}/{file}").replace(['\n', '\r'], "_"), source.text.clone())
        })
        .collect()
}

/// Role and source of an attachment.
pub(super) fn source_of((name, text): AttachedInput) -> (String, Source) {
    let (role, file) = name.split_once('/').unwrap_or((&name, &name));
    (role.to_owned(), Source::new(file, text))
}

/// The metadata record of what came from `input`, whose files are `inputs`.
pub(super) fn metadata_of(input: &InputSummary, inputs: &[AttachedInput]) -> BTreeMap<String, String> {
    let names: Vec<&str> = inputs.iter().map(|(name, _)| name.as_str()).collect();
    let mut metadata: BTreeMap<String, String> = [
        ("schema", SCHEMA.to_owned()),
        ("software", Provenance::software().to_owned()),
        ("method", METHOD.to_string()),
        ("input_kind", input.kind.to_owned()),
        ("input_name", input.name.clone()),
        ("input_sha256", input.sha256.clone()),
        ("attachments", names.join("\n")),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .into();
    if let Some(seed) = input.seed {
        metadata.insert("seed".to_owned(), seed.to_string());
    }
    if let Some((trial, plant)) = input.trial {
        metadata.insert("trial".to_owned(), trial.to_string());
        metadata.insert("plant".to_owned(), plant.key().to_owned());
    }
    let hash = hash(&metadata, inputs);
    metadata.insert("provenance_sha256".to_owned(), hash);
    metadata
}

/// SHA-256 over metadata (without that hash itself) and input files, each part preceded by its length, hexadecimal.
fn hash(metadata: &BTreeMap<String, String>, inputs: &[AttachedInput]) -> String {
    let mut digest = Sha256::new();
    let mut part = |text: &str| {
        digest.update((text.len() as u64).to_le_bytes());
        digest.update(text);
    };
    for (key, value) in metadata.iter().filter(|(key, _)| *key != "provenance_sha256") {
        part(key);
        part(value);
    }
    for (name, text) in inputs {
        part(name);
        part(text);
    }
    hex(&digest.finalize())
}

/// Bytes in hexadecimal.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |hex, byte| format!("{hex}{byte:02x}"))
}

impl Provenance {
    /// Name and version of this program.
    pub fn software() -> &'static str {
        concat!("calibrig ", env!("CARGO_PKG_VERSION"))
    }

    /// Reads and checks what a recording says of itself.
    pub(super) fn check(
        metadata: &BTreeMap<String, String>,
        inputs: &[AttachedInput],
    ) -> Result<Self, RecordingError> {
        check_schema(metadata)?;
        check_attachments(&text(metadata, "attachments")?, inputs)?;
        let expected = text(metadata, "provenance_sha256")?;
        let found = hash(metadata, inputs);
        if found != expected {
            return Err(RecordingError::AlteredProvenance { expected, found });
        }
        let trial = number(metadata, "trial", "a whole number below 2^32")?.map(|number| {
            let plant = metadata.get("plant");
            let known = PlantKind::ALL.into_iter().find(|kind| plant.is_some_and(|key| key == kind.key()));
            Ok::<_, RecordingError>((number, known.ok_or_else(|| bad("plant", plant, "rapier or analytic"))?))
        });
        let method: Option<NonZeroU32> = number(metadata, "method", "a whole number from 1 to 4294967295")?;
        Ok(Self {
            software: text(metadata, "software")?,
            method: method.map_or(1, NonZeroU32::get),
            input_kind: text(metadata, "input_kind")?,
            input_name: text(metadata, "input_name")?,
            input_sha256: text(metadata, "input_sha256")?,
            seed: number(metadata, "seed", "a whole number below 2^64")?,
            trial: trial.transpose()?,
            provenance_sha256: expected,
        })
    }
}

fn bad(key: &str, found: Option<&String>, expected: &'static str) -> RecordingError {
    let found = found.map_or_else(|| "nothing".to_owned(), |value| format!("{value:?}"));
    RecordingError::BadProvenance { key: key.to_owned(), found, expected }
}

/// The number of a key, if it is there.
fn number<T: FromStr>(
    metadata: &BTreeMap<String, String>,
    key: &str,
    expected: &'static str,
) -> Result<Option<T>, RecordingError> {
    let stated = metadata.get(key);
    stated.map(|text| text.parse().map_err(|_| bad(key, stated, expected))).transpose()
}

fn text(metadata: &BTreeMap<String, String>, key: &str) -> Result<String, RecordingError> {
    metadata.get(key).cloned().ok_or_else(|| bad(key, None, "a text"))
}

fn check_schema(metadata: &BTreeMap<String, String>) -> Result<(), RecordingError> {
    let found = metadata.get("schema");
    let version = found.and_then(|s| s.strip_prefix(SCHEMA_NAME)).and_then(|v| v.parse::<u32>().ok());
    match version {
        Some(1..=SCHEMA_VERSION) => Ok(()),
        Some(version) if version > SCHEMA_VERSION => Err(RecordingError::NewerSchema {
            found: found.cloned().unwrap_or_default(),
            software: metadata.get("software").cloned().unwrap_or_else(|| "not stated".to_owned()),
        }),
        _ => Err(bad("schema", found, SCHEMA)),
    }
}

fn check_attachments(stated: &str, inputs: &[AttachedInput]) -> Result<(), RecordingError> {
    let expected: Vec<String> = stated.lines().map(str::to_owned).collect();
    let missing: Vec<String> =
        expected.iter().filter(|name| !inputs.iter().any(|(n, _)| n == *name)).cloned().collect();
    if missing.is_empty() { Ok(()) } else { Err(RecordingError::MissingAttachments { missing, expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    fn parts() -> (BTreeMap<String, String>, Vec<AttachedInput>) {
        let outcome = synthetic::outcome(3, 2, true);
        let inputs = attached_inputs(&outcome.sources);
        (metadata_of(&outcome.input, &inputs), inputs)
    }

    #[test]
    fn provenance_is_read_back() {
        let (metadata, inputs) = parts();
        let provenance = Provenance::check(&metadata, &inputs).expect("sound");
        assert_eq!(provenance.seed, Some(7));
        assert_eq!(provenance.input_kind, "scenario");
        assert_eq!(provenance.method, METHOD);
        assert_eq!(provenance.provenance_sha256.len(), 64);
        let (role, source) = source_of(inputs[0].clone());
        assert_eq!((role.as_str(), source.name.as_str()), ("scenario", "synthetic.toml"));
    }

    #[test]
    fn every_change_of_metadata_or_inputs_is_noticed() {
        let (metadata, inputs) = parts();
        for key in ["software", "method", "input_name", "input_sha256", "seed", "provenance_sha256"] {
            let mut altered = metadata.clone();
            altered.insert(key.to_owned(), "8".to_owned());
            assert!(
                matches!(Provenance::check(&altered, &inputs), Err(RecordingError::AlteredProvenance { .. })),
                "{key}"
            );
        }
        let mut altered = inputs.clone();
        altered[1].1.push(' ');
        assert!(matches!(
            Provenance::check(&metadata, &altered),
            Err(RecordingError::AlteredProvenance { .. })
        ));
        // The same text, split differently between name and contents.
        let mut altered = inputs.clone();
        altered.push(("extra".to_owned(), String::new()));
        assert!(matches!(
            Provenance::check(&metadata, &altered),
            Err(RecordingError::AlteredProvenance { .. })
        ));
    }

    #[test]
    fn a_recording_from_before_the_method_had_a_number_has_the_first() {
        let (mut metadata, inputs) = parts();
        let with = |metadata: &mut BTreeMap<String, String>| {
            let hash = hash(metadata, &inputs);
            metadata.insert("provenance_sha256".to_owned(), hash);
            Provenance::check(metadata, &inputs)
        };
        metadata.remove("method");
        assert_eq!(with(&mut metadata).expect("older").method, 1);
        metadata.insert("method".to_owned(), "7".to_owned());
        assert_eq!(with(&mut metadata).expect("newer").method, 7);
        for nonsense in ["0", "-1", "two", ""] {
            metadata.insert("method".to_owned(), nonsense.to_owned());
            let error = with(&mut metadata).expect_err("no number");
            assert!(error.to_string().contains("method"), "{error}");
        }
    }

    #[test]
    fn the_schema_is_its_name_and_version() {
        assert_eq!(SCHEMA, format!("{SCHEMA_NAME}{SCHEMA_VERSION}"));
    }

    #[test]
    fn refusals_say_what_is_missing_and_what_was_expected() {
        let (metadata, inputs) = parts();
        let error = Provenance::check(&metadata, &inputs[1..]).expect_err("one is missing");
        assert!(error.to_string().contains("scenario/synthetic.toml"), "{error}");

        let mut newer = metadata.clone();
        newer.insert("schema".to_owned(), "calibrig.recording/3".to_owned());
        let error = Provenance::check(&newer, &inputs).expect_err("newer");
        assert!(matches!(error, RecordingError::NewerSchema { .. }));
        assert!(error.to_string().contains(SCHEMA), "{error}");

        for nonsense in ["calibrig.recording/", "calibrig.recording/0", "calibrig.recording/-1", "ros2", ""] {
            let mut altered = metadata.clone();
            altered.insert("schema".to_owned(), nonsense.to_owned());
            let refused = Provenance::check(&altered, &inputs);
            assert!(matches!(refused, Err(RecordingError::BadProvenance { .. })), "{nonsense}");
        }
        for key in ["schema", "attachments", "provenance_sha256"] {
            let mut altered = metadata.clone();
            altered.remove(key);
            let error = Provenance::check(&altered, &inputs).expect_err("a key is missing");
            assert!(error.to_string().contains(key), "{error}");
        }
    }
}
