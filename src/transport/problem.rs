//! The one table from errors to RFC 9457 problem documents, for HTTP answers and Zenoh reply
//! errors alike.

use sutura_core::build::BuildError;
use sutura_core::edit::{EditError, EditKind};
use sutura_core::mesh::{MeshError, ReadError, ReadFault, SourceError};
use sutura_core::reduced::SimulationError;
use sutura_proto::Invalid;
use sutura_store::{InputError, StoreError};

/// Every kind of problem a client can meet. [`Kind::row`] is what it looks like from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    MalformedDocument,
    MalformedMesh,
    MalformedParameter,
    Unauthorized,
    Forbidden,
    NoRoute,
    NoSession,
    NoGeneration,
    NoBlock,
    NoSimulation,
    MethodNotAllowed,
    NotAcceptable,
    ReceiveTimeout,
    WrongGeneration,
    NotReady,
    SessionTaken,
    Cancelled,
    TooLarge,
    UnsupportedMediaType,
    ImpossibleMesh,
    ImpossibleConfiguration,
    ImpossibleEdit,
    ImpossibleValue,
    ImpossibleSimulation,
    UpgradeRequired,
    Full,
    TooOften,
    Internal,
    Damaged,
    Busy,
    ShuttingDown,
    StorageFailed,
    StorageFull,
}

impl Kind {
    #[cfg(test)]
    pub(crate) const ALL: [Kind; 33] = [
        Kind::MalformedDocument,
        Kind::MalformedMesh,
        Kind::MalformedParameter,
        Kind::Unauthorized,
        Kind::Forbidden,
        Kind::NoRoute,
        Kind::NoSession,
        Kind::NoGeneration,
        Kind::NoBlock,
        Kind::NoSimulation,
        Kind::MethodNotAllowed,
        Kind::NotAcceptable,
        Kind::ReceiveTimeout,
        Kind::WrongGeneration,
        Kind::NotReady,
        Kind::SessionTaken,
        Kind::Cancelled,
        Kind::TooLarge,
        Kind::UnsupportedMediaType,
        Kind::ImpossibleMesh,
        Kind::ImpossibleConfiguration,
        Kind::ImpossibleEdit,
        Kind::ImpossibleValue,
        Kind::ImpossibleSimulation,
        Kind::UpgradeRequired,
        Kind::Full,
        Kind::TooOften,
        Kind::Internal,
        Kind::Damaged,
        Kind::Busy,
        Kind::ShuttingDown,
        Kind::StorageFailed,
        Kind::StorageFull,
    ];

    /// Status, last part of the `type` URI, and title.
    fn row(self) -> (u16, &'static str, &'static str) {
        match self {
            Kind::MalformedDocument => (400, "malformed-document", "Malformed document"),
            Kind::MalformedMesh => (400, "malformed-mesh", "Malformed mesh file"),
            Kind::MalformedParameter => (400, "malformed-parameter", "Malformed parameter"),
            Kind::Unauthorized => (401, "unauthorized", "No valid key"),
            Kind::Forbidden => (403, "forbidden", "Forbidden"),
            Kind::NoRoute => (404, "no-route", "No such path"),
            Kind::NoSession => (404, "no-session", "No such session"),
            Kind::NoGeneration => (404, "no-generation", "No such generation"),
            Kind::NoBlock => (404, "no-block", "No such block of columns"),
            Kind::NoSimulation => (404, "no-simulation", "No simulation"),
            Kind::MethodNotAllowed => (405, "method-not-allowed", "Method not allowed"),
            Kind::NotAcceptable => (406, "not-acceptable", "Not acceptable"),
            Kind::ReceiveTimeout => (408, "receive-timeout", "The request took too long to arrive"),
            Kind::WrongGeneration => (409, "wrong-generation", "Not the current generation"),
            Kind::NotReady => (409, "not-ready", "The session is not ready"),
            Kind::SessionTaken => (409, "session-taken", "Another daemon serves the session"),
            Kind::Cancelled => (409, "cancelled", "The work was cancelled"),
            Kind::TooLarge => (413, "too-large", "Too large"),
            Kind::UnsupportedMediaType => (415, "unsupported-media-type", "Unsupported media type"),
            Kind::ImpossibleMesh => (422, "impossible-mesh", "Impossible mesh"),
            Kind::ImpossibleConfiguration => {
                (422, "impossible-configuration", "Impossible configuration")
            }
            Kind::ImpossibleEdit => (422, "impossible-edit", "Impossible edit"),
            Kind::ImpossibleValue => (422, "impossible-value", "Impossible value"),
            Kind::ImpossibleSimulation => (422, "impossible-simulation", "Impossible simulation"),
            Kind::UpgradeRequired => (426, "upgrade-required", "WebSocket upgrade required"),
            Kind::Full => (429, "full", "As many as allowed exist"),
            Kind::TooOften => (429, "too-often", "Too many requests"),
            Kind::Internal => (500, "internal", "Internal error"),
            Kind::Damaged => (410, "damaged-data", "Kept data is damaged"),
            Kind::Busy => (503, "busy", "Too busy"),
            Kind::ShuttingDown => (503, "shutting-down", "Shutting down"),
            Kind::StorageFailed => (503, "storage-failed", "The storage failed"),
            Kind::StorageFull => (507, "storage-full", "No room to keep it"),
        }
    }

    /// The HTTP status; over Zenoh too.
    pub(crate) fn status(self) -> u16 {
        self.row().0
    }

    /// The title, as the API's description shows it.
    pub(crate) fn title(self) -> &'static str {
        self.row().2
    }
}

/// Seconds after which a refusal for want of room is worth another try.
const FULL_RETRY_AFTER_S: u64 = 30;
/// Seconds after which a storage that failed is tried again.
const STORAGE_RETRY_AFTER_S: u64 = 10;
/// Seconds after which a daemon that lost a session to another one would take it back.
const TAKEN_RETRY_AFTER_S: u64 = sutura_store::HAND_OVER.as_secs();
/// Seconds a daemon that goes down is given to come back.
const SHUTDOWN_RETRY_AFTER_S: u64 = 5;

/// What went wrong with one request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Problem {
    pub(crate) kind: Kind,
    pub(crate) detail: String,
    /// JSON pointer into the request.
    pub(crate) pointer: Option<String>,
    /// Seconds after which to try again.
    pub(crate) retry_after_s: Option<u64>,
}

impl Problem {
    pub(crate) fn new(kind: Kind, detail: impl Into<String>) -> Problem {
        Problem { kind, detail: detail.into(), pointer: None, retry_after_s: None }
    }

    /// The input at `pointer` is at fault.
    pub(crate) fn at(self, pointer: impl Into<String>) -> Problem {
        Problem { pointer: Some(pointer.into()), ..self }
    }

    /// The member at fault has another name in the document that this answers.
    pub(crate) fn moved(self, from: &str, to: &str) -> Problem {
        Problem { pointer: self.pointer.map(|pointer| pointer.replacen(from, to, 1)), ..self }
    }

    pub(crate) fn retry_after(self, seconds: u64) -> Problem {
        Problem { retry_after_s: Some(seconds), ..self }
    }

    pub(crate) fn status(&self) -> u16 {
        self.kind.status()
    }

    /// Leaves a trace of what is our own fault.
    pub(crate) fn log(&self) {
        match self.kind {
            Kind::Internal => tracing::error!(self.detail, "a request met a defect"),
            Kind::StorageFailed | Kind::StorageFull => {
                tracing::error!(self.detail, "a request could not be made to last");
            }
            _ => {}
        }
    }

    /// The document as it travels.
    pub(crate) fn to_document(&self) -> sutura_proto::Problem {
        let (status, name, title) = self.kind.row();
        sutura_proto::Problem {
            kind: format!("urn:sutura:problem:{name}"),
            title: title.to_owned(),
            status,
            detail: self.detail.clone(),
            instance_pointer: self.pointer.clone(),
        }
    }

    /// The document as JSON bytes.
    pub(crate) fn to_json(&self) -> Vec<u8> {
        // Strings and an integer always serialize.
        serde_json::to_vec(&self.to_document()).unwrap_or_default()
    }
}

impl From<Invalid> for Problem {
    fn from(error: Invalid) -> Problem {
        Problem::new(Kind::ImpossibleValue, error.detail).at(error.pointer)
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Problem {
        Problem::from(&error)
    }
}

impl From<&StoreError> for Problem {
    fn from(error: &StoreError) -> Problem {
        let kind = match error {
            StoreError::NoSession(_) => Kind::NoSession,
            StoreError::Taken(_) => Kind::SessionTaken,
            StoreError::NoGeneration { .. } => Kind::NoGeneration,
            StoreError::NoSimulation => Kind::NoSimulation,
            StoreError::WrongGeneration { .. } => Kind::WrongGeneration,
            StoreError::NotReady { .. } => Kind::NotReady,
            StoreError::Busy { .. } => Kind::Busy,
            StoreError::Full { .. } => Kind::Full,
            StoreError::TooLarge { .. } => Kind::TooLarge,
            StoreError::Input(_) => Kind::ImpossibleValue,
            StoreError::Build(BuildError::OverBudget { .. }) => Kind::TooLarge,
            StoreError::Build(_) => Kind::ImpossibleConfiguration,
            StoreError::Edit(_) => Kind::ImpossibleEdit,
            StoreError::Simulation(_) => Kind::ImpossibleSimulation,
            StoreError::Cancelled => Kind::Cancelled,
            StoreError::ShuttingDown => Kind::ShuttingDown,
            StoreError::Failed { .. } => Kind::Internal,
            StoreError::Damaged { .. } => Kind::Damaged,
            StoreError::Storage(error) if error.is_full() => Kind::StorageFull,
            StoreError::Storage(_) => Kind::StorageFailed,
        };
        let pointer = match error {
            StoreError::WrongGeneration { .. } => Some("/base_generation".to_owned()),
            StoreError::Input(error) => input_pointer(error),
            StoreError::Build(error) => build_pointer(error),
            StoreError::Edit(error) => Some(edit_pointer(error)),
            StoreError::Simulation(error) => simulation_pointer(error),
            _ => None,
        };
        let retry_after_s = match error {
            StoreError::Busy { retry_after_s } => Some((*retry_after_s).max(1)),
            StoreError::Full { .. } => Some(FULL_RETRY_AFTER_S),
            StoreError::ShuttingDown => Some(SHUTDOWN_RETRY_AFTER_S),
            StoreError::Storage(_) => Some(STORAGE_RETRY_AFTER_S),
            StoreError::Taken(_) => Some(TAKEN_RETRY_AFTER_S),
            _ => None,
        };
        Problem { kind, detail: error.to_string(), pointer, retry_after_s }
    }
}

/// An error met while a body is built: edits are then those that its seams prepare.
pub(crate) fn of_build(error: &StoreError) -> Problem {
    match error {
        StoreError::Edit(error) => of_seam(error, &[]),
        _ => Problem::from(error),
    }
}

/// A candidate pair that cannot be stitched. `positions` says where each pair that was tried stands
/// in the configuration; a pair beyond them stands where it was tried.
pub(crate) fn of_seam(error: &EditError, positions: &[usize]) -> Problem {
    // The error counts edits, but a seam belongs to none.
    let detail = error.to_string();
    let detail = detail.split_once(": ").map_or(detail.as_str(), |(_, rest)| rest);
    let problem = Problem::new(Kind::ImpossibleConfiguration, detail);
    match pair_of(error) {
        Some(pair) => {
            let pair = positions.get(pair).copied().unwrap_or(pair);
            problem.at(format!("/seams/{pair}"))
        }
        None => problem,
    }
}

/// An inline mesh that is none.
pub(crate) fn of_inline_mesh(error: MeshError) -> Problem {
    let pointer = match error {
        MeshError::NonFinite { vertex, axis } => format!("/mesh/vertices/{vertex}/{axis}"),
        MeshError::VertexOutOfRange { tet, corner, .. } => format!("/mesh/tets/{tet}/{corner}"),
        MeshError::RepeatedVertex { tet, .. }
        | MeshError::Inverted { tet, .. }
        | MeshError::Flat { tet, .. } => format!("/mesh/tets/{tet}"),
        MeshError::LabelCount { .. } => "/mesh/domains".to_owned(),
        MeshError::NoTets => "/mesh/tets".to_owned(),
        MeshError::TooManyVertices { .. } => "/mesh/vertices".to_owned(),
    };
    let kind = match error {
        MeshError::TooManyVertices { .. } => Kind::TooLarge,
        _ => Kind::ImpossibleMesh,
    };
    Problem::new(kind, error.to_string()).at(pointer)
}

impl From<ReadError> for Problem {
    fn from(error: ReadError) -> Problem {
        let kind = match &error.fault {
            ReadFault::Mesh { error: MeshError::TooManyVertices { .. }, .. }
            | ReadFault::OverLimit { .. } => Kind::TooLarge,
            ReadFault::Mesh { .. } | ReadFault::Material { .. } => Kind::ImpossibleMesh,
            _ => Kind::MalformedMesh,
        };
        Problem::new(kind, error.to_string()).at("/mesh")
    }
}

impl From<SourceError> for Problem {
    fn from(error: SourceError) -> Problem {
        let kind = match error {
            SourceError::Read(error) => return error.into(),
            SourceError::Unknown => Kind::UnsupportedMediaType,
            SourceError::HalfTetGen | SourceError::TooManyFiles => Kind::MalformedDocument,
        };
        Problem::new(kind, error.to_string()).at("/mesh")
    }
}

fn input_pointer(error: &InputError) -> Option<String> {
    Some(match error {
        InputError::Name => "/name".to_owned(),
        InputError::NoEdits => "/edits".to_owned(),
        InputError::Tolerance(_) => "/tolerance".to_owned(),
        InputError::PoseLength { pose, .. } | InputError::PoseOverflows { pose } => {
            format!("/q/{pose}")
        }
        InputError::PoseNotFinite { pose, index } => format!("/q/{pose}/{index}"),
        InputError::TimeStep { .. } => "/dt_s".to_owned(),
        InputError::PublishRate { .. } => "/publish_hz".to_owned(),
        InputError::Obstacle { obstacle, .. } => format!("/obstacles/{obstacle}"),
        InputError::Contact { name, .. } => format!("/contact/{name}"),
        InputError::GrabVertex { grab, .. } => format!("/grabs/{grab}/vertex"),
        InputError::GrabTarget { grab } => format!("/grabs/{grab}/target_m"),
        InputError::GrabStrength { grab, name, .. } => format!("/grabs/{grab}/{name}"),
        InputError::ForceVertex { force, .. } => format!("/forces/{force}/vertex"),
        InputError::ForceSize { force, .. } => format!("/forces/{force}/force_n"),
        InputError::ForceDuration { force, .. } => format!("/forces/{force}/duration_s"),
    })
}

fn edit_pointer(error: &EditError) -> String {
    match error {
        EditError::VertexOutOfRange { edit, kind, position, .. }
        | EditError::UnusedVertex { edit, kind, position, .. } => {
            let entries = match kind {
                EditKind::Fix | EditKind::Release => "vertices",
                _ => "pairs",
            };
            format!("/edits/{edit}/{}/{entries}/{position}", member(*kind))
        }
        EditError::SameVertex { edit, kind, pair, .. }
        | EditError::BothFixed { edit, kind, pair, .. }
        | EditError::AlreadyStitched { edit, kind, pair, .. } => {
            format!("/edits/{edit}/{}/pairs/{pair}", member(*kind))
        }
        EditError::Apart { edit, pair, .. } => format!("/edits/{edit}/stitch/pairs/{pair}"),
        EditError::AlreadyFixed { edit, position, .. } => {
            format!("/edits/{edit}/fix/vertices/{position}")
        }
        EditError::NotFixed { edit, position, .. } => {
            format!("/edits/{edit}/release/vertices/{position}")
        }
        EditError::NotClosed { edit, pair, .. } => format!("/edits/{edit}/close/pairs/{pair}"),
        EditError::MaxGap { edit, .. } => format!("/edits/{edit}/close/max_gap_m"),
        EditError::StitchOpens { edit, .. } | EditError::ClosedShape { edit, .. } => {
            format!("/edits/{edit}/close/pairs")
        }
        EditError::NothingFree { edit } => format!("/edits/{edit}/fix/vertices"),
        EditError::Stiffness { edit, kind, .. } => {
            format!("/edits/{edit}/{}/stiffness_n_m", member(*kind))
        }
        EditError::UnknownStitch { edit, kind, position, .. } => {
            format!("/edits/{edit}/{}/stitch_ids/{position}", member(*kind))
        }
        EditError::UnknownDomain { edit, .. } => {
            format!("/edits/{edit}/scale_stiffness/domain")
        }
        EditError::StiffnessFactor { edit, .. } => {
            format!("/edits/{edit}/scale_stiffness/factor")
        }
    }
}

/// An edit's member in a request.
fn member(kind: EditKind) -> &'static str {
    match kind {
        EditKind::Stitch => "stitch",
        EditKind::Unstitch => "unstitch",
        EditKind::UnstitchAll => "unstitch_all",
        EditKind::SetStiffness => "set_stiffness",
        EditKind::ScaleStiffness => "scale_stiffness",
        EditKind::Fix => "fix",
        EditKind::Release => "release",
        EditKind::Close => "close",
    }
}

fn pair_of(error: &EditError) -> Option<usize> {
    match error {
        EditError::VertexOutOfRange { position, .. } | EditError::UnusedVertex { position, .. } => {
            Some(*position)
        }
        EditError::SameVertex { pair, .. }
        | EditError::Apart { pair, .. }
        | EditError::BothFixed { pair, .. }
        | EditError::AlreadyStitched { pair, .. } => Some(*pair),
        _ => None,
    }
}

fn build_pointer(error: &BuildError) -> Option<String> {
    match error {
        BuildError::FixedVertexOutOfRange { position, .. } => {
            Some(format!("/fixed_vertices/{position}"))
        }
        BuildError::NothingFree => Some("/fixed_vertices".to_owned()),
        BuildError::TetStiffnessCount { .. } => Some("/tet_stiffness".to_owned()),
        BuildError::TetStiffness { tet, .. } => Some(format!("/tet_stiffness/{tet}")),
        BuildError::OutOfRange { name, .. } | BuildError::BadParameter { name, .. } => {
            parameter_pointer(name).map(str::to_owned)
        }
        _ => None,
    }
}

/// Where the configuration holds the build parameter that the core calls `name`.
fn parameter_pointer(name: &str) -> Option<&'static str> {
    Some(match name {
        "n_modes" => "/n_modes",
        "basis_size" => "/basis/size",
        "n_derivative_modes" => "/basis/n_derivative_modes",
        "n_points" => "/cubature/n_points",
        "n_training_poses" => "/cubature/n_training_poses",
        "mass_per_s" => "/damping/rayleigh_mass_per_s",
        "stiffness_s" => "/damping/rayleigh_stiffness_s",
        _ => return None,
    })
}

fn simulation_pointer(error: &SimulationError) -> Option<String> {
    match error {
        SimulationError::TimeStep(_) => Some("/dt_s".to_owned()),
        SimulationError::Gravity => Some("/gravity_m_s2".to_owned()),
        SimulationError::SubstepTolerance(_) => Some("/substep_tolerance".to_owned()),
        SimulationError::NoEquilibrium => Some("/integrator".to_owned()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use sutura_core::mesh::Location;
    use sutura_store::SessionState;

    #[test]
    fn every_kind_has_its_own_name_and_an_error_status() {
        let mut names = BTreeSet::new();
        for kind in Kind::ALL {
            let (status, name, title) = kind.row();
            assert!((400..600).contains(&status), "{name}");
            assert!(names.insert(name), "{name} twice");
            assert!(!title.is_empty());
        }
    }

    #[test]
    fn only_a_defect_of_ours_is_a_500() {
        let fives = Kind::ALL.iter().filter(|kind| kind.status() == 500);
        assert_eq!(fives.collect::<Vec<_>>(), [&Kind::Internal]);
    }

    #[test]
    fn store_errors_keep_their_place_and_their_words() {
        let cases = [
            (StoreError::WrongGeneration { given: 3, current: 5 }, 409, Some("/base_generation")),
            (StoreError::NotReady { state: SessionState::Building }, 409, None),
            (StoreError::NoSimulation, 404, None),
            (StoreError::NoGeneration { number: 9, oldest: 0, current: 1 }, 404, None),
            (StoreError::TooLarge { what: "tets", limit: 1, given: 2 }, 413, None),
            (StoreError::Full { what: "sessions", limit: 1 }, 429, None),
            (StoreError::Busy { retry_after_s: 0 }, 503, None),
            (StoreError::ShuttingDown, 503, None),
            (
                StoreError::Edit(EditError::SameVertex {
                    edit: 1,
                    kind: EditKind::Stitch,
                    pair: 2,
                    vertex: 7,
                }),
                422,
                Some("/edits/1/stitch/pairs/2"),
            ),
            (
                StoreError::Edit(EditError::UnknownStitch {
                    edit: 0,
                    kind: EditKind::Unstitch,
                    position: 4,
                    id: 9,
                }),
                422,
                Some("/edits/0/unstitch/stitch_ids/4"),
            ),
            (
                StoreError::Build(BuildError::OutOfRange {
                    name: "n_modes",
                    value: 9,
                    low: 1,
                    high: 3,
                }),
                422,
                Some("/n_modes"),
            ),
            (StoreError::Input(InputError::Tolerance(-1.0)), 422, Some("/tolerance")),
            (StoreError::Simulation(SimulationError::PartlyFree { n_rigid_modes: 6 }), 422, None),
            (StoreError::Failed { what: "build" }, 500, None),
        ];
        for (error, status, pointer) in cases {
            let problem = Problem::from(&error);
            assert_eq!(
                (problem.status(), problem.pointer.as_deref()),
                (status, pointer),
                "{error}"
            );
            assert_eq!(problem.detail, error.to_string());
            let retry = matches!(status, 429 | 503);
            assert_eq!(problem.retry_after_s.is_some(), retry, "{error}");
            assert_ne!(problem.retry_after_s, Some(0));
        }
    }

    #[test]
    fn a_seam_at_fault_is_pointed_at_in_the_configuration() {
        let kind = EditKind::Stitch;
        let error = StoreError::Edit(EditError::SameVertex { edit: 0, kind, pair: 2, vertex: 7 });
        let problem = of_build(&error);
        assert_eq!(problem.pointer.as_deref(), Some("/seams/2"));
        assert_eq!(problem.kind, Kind::ImpossibleConfiguration);
    }

    #[test]
    fn inline_meshes_are_pointed_into_and_files_are_located_by_line() {
        let error = MeshError::Inverted { tet: 5, volume_m3: -1.0 };
        let problem = of_inline_mesh(error.clone());
        assert_eq!((problem.status(), problem.pointer.as_deref()), (422, Some("/mesh/tets/5")));

        let fault = ReadFault::Mesh { item: "element 6".into(), error };
        let problem = Problem::from(ReadError { location: Location::Line(12), fault });
        assert_eq!(problem.status(), 422);
        assert!(problem.detail.starts_with("line 12: element 6"), "{}", problem.detail);

        let fault = ReadFault::Truncated { what: "nodes", declared: 9, remaining: 1 };
        let problem = Problem::from(ReadError { location: Location::Byte(3), fault });
        assert_eq!(problem.status(), 400);
    }

    #[test]
    fn the_document_is_the_contract_s() {
        let problem = Problem::new(Kind::NoSession, "there is no session x").at("/id");
        let document: serde_json::Value = serde_json::from_slice(&problem.to_json()).unwrap();
        assert_eq!(
            document,
            serde_json::json!({
                "type": "urn:sutura:problem:no-session", "title": "No such session",
                "status": 404, "detail": "there is no session x", "instance_pointer": "/id"
            })
        );
    }
}
