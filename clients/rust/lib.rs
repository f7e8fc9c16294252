//! sutura-client
