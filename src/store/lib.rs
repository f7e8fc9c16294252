//! sutura-store
