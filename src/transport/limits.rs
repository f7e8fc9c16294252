//! Every bound that the two transports keep, in one place. Bounds on what a document may ask for
//! (vertices, modes, stitches, poses …) and on the work done at once belong to the store.

use std::time::Duration;

/// Bounds on what clients may ask of the transports.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Largest uploaded mesh file, in bytes.
    pub max_mesh_bytes: usize,
    /// Largest JSON document that may hold an inline mesh, in bytes.
    pub max_inline_mesh_bytes: usize,
    /// Largest other JSON or bincode document, in bytes.
    pub max_document_bytes: usize,
    /// Requests a second in the long run from one tenant (or, without keys, from all together), over HTTP
    /// and Zenoh; beyond, they are refused with 429.
    pub max_requests_per_s: f64,
    /// Requests at once that are let in whatever the rate.
    pub max_request_burst: usize,
    /// HTTP connections open at the same time; further ones wait to be accepted.
    pub max_connections: usize,
    /// Requests answered at the same time over HTTP; beyond, requests are shed with 503.
    pub max_requests: usize,
    /// Uploads received and parsed at the same time: each may hold `max_mesh_bytes` of memory.
    pub max_uploads: usize,
    /// How long a request waits for its turn to upload before it is shed.
    pub max_upload_queue_wait: Duration,
    /// Longest time in which a request's body must have arrived.
    pub max_receive_time: Duration,
    /// Longest `?wait_s`.
    pub max_ready_wait: Duration,
    /// Sessions on one page of the list.
    pub max_page: usize,
    /// Numbers in the answer to one evaluation request: poses × basis size².
    pub max_evaluation_numbers: usize,
    /// Largest array sent over HTTP, in bytes.
    pub max_array_bytes: usize,
    /// Largest array sent over Zenoh, in bytes: clients bound the messages they accept.
    pub max_bus_array_bytes: usize,
    /// WebSocket and event streams open at the same time.
    pub max_streams: usize,
    /// How long one frame may take to be sent before its stream is closed.
    pub max_send_wait: Duration,
    /// Zenoh queries answered at the same time; beyond, queries are answered with a 503 problem.
    pub max_queries: usize,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits {
            max_mesh_bytes: 512 << 20,
            max_inline_mesh_bytes: 128 << 20,
            max_document_bytes: 8 << 20,
            max_requests_per_s: 2000.0,
            max_request_burst: 4000,
            max_connections: 1024,
            max_requests: 256,
            max_uploads: 4,
            max_upload_queue_wait: Duration::from_secs(2),
            max_receive_time: Duration::from_secs(120),
            max_ready_wait: Duration::from_secs(600),
            max_page: 200,
            max_evaluation_numbers: 4 << 20,
            max_array_bytes: 1 << 30,
            max_bus_array_bytes: 120 << 20,
            max_streams: 256,
            max_send_wait: Duration::from_secs(10),
            max_queries: 64,
        }
    }
}
