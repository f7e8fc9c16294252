//! sutura-proto
