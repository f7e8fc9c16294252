//! Tests of the core against mathematics, against other codes and against itself. One binary; the
//! files beside this one are its modules, each a subject.

mod bodies;
mod certificates;
mod closings;
mod combinations;
mod dynamics;
mod free_bodies;
mod full_model;
mod generations;
mod interaction;
mod lanczos;
mod materials;
mod modes;
mod rebasing;
mod recipes;
mod reduced;
mod references;
mod refusals;
mod seams;
mod series;
mod snapshots;
mod supports;
mod trajectories;
mod updates;
mod vega;
