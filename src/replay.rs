//! Identification from a recording alone.
