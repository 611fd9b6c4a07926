//! Studies of many trials: what varies and how it is drawn, tables of rows in Parquet, shards that make one table, and its
//! statistics.
//!
//! This crate knows nothing about robots: a trial is a number, a point of a design and a row.

pub mod design;
pub mod distribution;
pub mod plan;
pub mod sensitivity;
pub mod shards;
pub mod statistics;
pub mod table;
