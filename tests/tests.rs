//! Integration tests: one binary, a module a subject.

mod access;
mod arrays;
mod bodies;
mod conformance;
mod daemon;
mod demo;
mod disks;
mod doctor;
mod durability;
mod edits;
mod links;
mod operations;
mod plain_http;
mod refusals;
mod simulation;
mod telemetry;
mod tls;
mod walls;
