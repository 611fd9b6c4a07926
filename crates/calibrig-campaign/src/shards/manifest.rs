//! What determines a campaign.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::table::{Column, hexadecimal};

/// The schema of a manifest.
const SCHEMA: &str = "calibrig.manifest/1";

/// Which program computes the trials: another one may round differently.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Software {
    /// Of the package.
    pub version: String,
    /// SHA-256 of the program's file, hexadecimal.
    pub binary_sha256: String,
    /// Processor and system.
    pub target: String,
}

/// A file that trials depend on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    /// What it is.
    pub role: String,
    /// SHA-256 of its text, hexadecimal.
    pub sha256: String,
}

/// What determines a campaign: trial n is a function of this and n.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// `calibrig.manifest/1`.
    pub schema: String,
    /// Name for people.
    pub name: String,
    /// The scenario's file as it was named, for people; on another machine it may be elsewhere.
    pub scenario: String,
    /// The program.
    pub software: Software,
    /// All files.
    pub inputs: Vec<Input>,
    /// Key of the random streams.
    pub seed: u64,
    /// The first trial.
    pub first: u64,
    /// Number of trials.
    pub trials: u64,
    /// Parts that machines take.
    pub shards: u32,
    /// What varies, and everything else that the caller fixes.
    pub study: serde_json::Value,
    /// Of the table; the first one is the trial.
    pub columns: Vec<Column>,
}

impl Manifest {
    /// The schema that this program writes and reads.
    pub fn schema() -> String {
        SCHEMA.to_owned()
    }

    /// SHA-256 of everything that rows depend on, hexadecimal: the same trials give the same rows however they are divided, and wherever files
    /// are.
    pub fn sum(&self) -> String {
        let whole = Self { shards: 0, scenario: String::new(), ..self.clone() };
        // A manifest of plain fields is always JSON.
        let text = serde_json::to_string(&whole).unwrap_or_default();
        hexadecimal(&Sha256::digest(text))
    }

    /// The trials.
    pub fn range(&self) -> Range<u64> {
        self.first..self.first.saturating_add(self.trials)
    }

    /// The trials of a shard: as many as of any other, or one more.
    pub fn range_of(&self, shard: u32) -> Range<u64> {
        let at = |shard: u32| {
            let place = u128::from(self.trials) * u128::from(shard) / u128::from(self.shards.max(1));
            // At most `trials`.
            self.first.saturating_add(u64::try_from(place).unwrap_or(self.trials))
        };
        at(shard)..at(shard.saturating_add(1))
    }

    /// How `other` differs, in words; `None` if it is the same campaign in the same shards.
    pub fn difference(&self, other: &Self) -> Option<String> {
        if (self.sum(), self.shards) == (other.sum(), other.shards) {
            return None;
        }
        let differs = |what: &str, ours: &dyn std::fmt::Display, theirs: &dyn std::fmt::Display| {
            Some(format!("{what} {theirs} instead of {ours}"))
        };
        if self.schema != other.schema {
            return differs("schema", &self.schema, &other.schema);
        }
        if self.software.version != other.software.version {
            return differs("software version", &self.software.version, &other.software.version);
        }
        if self.software.target != other.software.target {
            return differs("machines", &self.software.target, &other.software.target);
        }
        if self.software != other.software {
            return Some(format!("a different build of version {}", other.software.version));
        }
        for input in &self.inputs {
            match other.inputs.iter().find(|theirs| theirs.role == input.role) {
                Some(theirs) if theirs == input => {}
                Some(_) => return Some(format!("a different text of the {}", input.role)),
                None => return Some(format!("no {}", input.role)),
            }
        }
        if self.seed != other.seed {
            return differs("seed", &self.seed, &other.seed);
        }
        if self.range() != other.range() {
            let words = |m: &Self| format!("{} trials from {}", m.trials, m.first);
            return differs("", &words(self), &words(other)).map(|text| text.trim_start().to_owned());
        }
        if self.shards != other.shards {
            return differs("shards:", &self.shards, &other.shards);
        }
        if self.study == other.study {
            Some("different columns".to_owned())
        } else {
            Some(self.study_difference(&other.study))
        }
    }

    /// The first key of the study that differs, with both values if they are short enough to read.
    fn study_difference(&self, theirs: &serde_json::Value) -> String {
        for (key, ours) in self.study.as_object().into_iter().flatten() {
            let theirs = theirs.get(key).unwrap_or(&serde_json::Value::Null);
            if ours != theirs {
                let is_long = |value: &serde_json::Value| value.is_array() || value.is_object();
                return if is_long(ours) || is_long(theirs) {
                    format!("a different study (key {key})")
                } else {
                    format!("{key} {theirs} instead of {ours}")
                };
            }
        }
        "a different study".to_owned()
    }
}
