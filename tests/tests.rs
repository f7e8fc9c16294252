//! Integration tests: one binary, a module a subject.

mod access;
mod arrays;
mod bodies;
mod conformance;
mod daemon;
mod demo;
mod durability;
mod edits;
mod operations;
mod refusals;
mod simulation;
mod walls;
