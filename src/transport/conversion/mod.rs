//! The only place where wire types and the types of store and core meet.

pub(crate) mod array;
pub(crate) mod document;
pub(crate) mod edit;
pub(crate) mod evaluate;
pub(crate) mod event;
pub(crate) mod session;
pub(crate) mod simulation;
