//! sutura-transport
