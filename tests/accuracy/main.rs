//! How good is a rebuilt basis? Static solutions in the subspace against the full nonlinear body.

mod bar;
mod bases;
mod table;
