//! The description of the HTTP API, `/openapi.json`: [`ROUTES`] says of each route what no other
//! can; what follows from its path, method and body is added. A test holds it against the router.

use crate::problem::Kind;
use std::collections::BTreeMap;
use sutura_proto::media::{EVENT_STREAM, FRAME, JSON, NPY, PROBLEM_JSON, STATE};
use sutura_proto::openapi::Components;
use utoipa::OpenApi as _;
use utoipa::openapi::path::{
    HttpMethod, Operation, OperationBuilder, Parameter, ParameterBuilder, ParameterIn,
};
use utoipa::openapi::request_body::{RequestBody, RequestBodyBuilder};
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, SchemaFormat, Type};
use utoipa::openapi::{Content, Info, OpenApi, Ref, Required, Response, ResponseBuilder};

/// The description of every route.
pub(super) fn document() -> OpenApi {
    let mut document = Components::openapi();
    document.info = Info::new("Sutura", env!("CARGO_PKG_VERSION"));
    document.info.description = Some(
        "Keeps deformable bodies ready for interactive editing. Errors are RFC 9457 problem \
         documents; every answer carries x-request-id."
            .to_owned(),
    );
    for route in ROUTES {
        document.paths.add_path_operation(
            route.path,
            vec![route.method.clone()],
            route.operation(),
        );
    }
    document
}

struct Route {
    method: HttpMethod,
    path: &'static str,
    summary: &'static str,
    /// Name and meaning of each query parameter.
    query: &'static [(&'static str, &'static str)],
    request: Body,
    status: u16,
    reply: Body,
    /// Problems that do not follow from path, method and request.
    problems: &'static [Kind],
}

/// What a request or an answer carries.
enum Body {
    Empty,
    /// A document of this schema.
    Json(&'static str),
    /// The upload of a session: a document, or a file and a document.
    Upload,
    /// Bytes of one of these media types.
    Bytes(&'static [&'static str]),
}

const ROUTES: &[Route] = &[
    Route {
        method: HttpMethod::Post,
        path: "/v1/sessions",
        summary: "Open a session and begin to build its body",
        query: &[("wait_s", "hold the answer until the build has ended, at most so many seconds")],
        request: Body::Upload,
        status: 202,
        reply: Body::Json("SessionInfo"),
        problems: &[
            Kind::MalformedMesh,
            Kind::MalformedParameter,
            Kind::ImpossibleMesh,
            Kind::ImpossibleConfiguration,
            Kind::ImpossibleValue,
            Kind::Full,
        ],
    },
    Route {
        method: HttpMethod::Get,
        path: "/v1/sessions",
        summary: "List the sessions, page by page, in the order in which they were opened",
        query: &[("after", "begin behind this session"), ("limit", "most sessions on the page")],
        request: Body::Empty,
        status: 200,
        reply: Body::Json("SessionList"),
        problems: &[Kind::MalformedParameter, Kind::NoSession],
    },
    Route {
        method: HttpMethod::Get,
        path: "/v1/sessions/{id}",
        summary: "Describe a session",
        query: &[("wait_s", "hold the answer until its body is there, at most so many seconds")],
        request: Body::Empty,
        status: 200,
        reply: Body::Json("SessionInfo"),
        problems: &[Kind::MalformedParameter],
    },
    Route {
        method: HttpMethod::Delete,
        path: "/v1/sessions/{id}",
        summary: "End a session and everything that runs for it",
        query: &[],
        request: Body::Empty,
        status: 204,
        reply: Body::Empty,
        problems: &[],
    },
    Route {
        method: HttpMethod::Post,
        path: "/v1/sessions/{id}/fork",
        summary: "Open a session with the same generations, sharing every artifact",
        query: &[],
        request: Body::Json("ForkRequest"),
        status: 201,
        reply: Body::Json("SessionInfo"),
        problems: &[Kind::NotReady, Kind::Full, Kind::ImpossibleValue],
    },
    Route {
        method: HttpMethod::Post,
        path: "/v1/sessions/{id}/seams",
        summary: "Name candidate pairs: they are prepared in the background",
        query: &[],
        request: Body::Json("SeamRequest"),
        status: 202,
        reply: Body::Json("SeamReply"),
        problems: &[Kind::NotReady, Kind::TooLarge, Kind::ImpossibleConfiguration],
    },
    Route {
        method: HttpMethod::Get,
        path: "/v1/sessions/{id}/events",
        summary: "Follow a session: one Event document in each server-sent event",
        query: &[],
        request: Body::Empty,
        status: 200,
        reply: Body::Bytes(&[EVENT_STREAM]),
        problems: &[],
    },
    Route {
        method: HttpMethod::Post,
        path: "/v1/sessions/{id}/edits",
        summary: "Edit the body: makes the next generation; going away cancels",
        query: &[],
        request: Body::Json("EditRequest"),
        status: 200,
        reply: Body::Json("EditReply"),
        problems: &[
            Kind::WrongGeneration,
            Kind::NotReady,
            Kind::Cancelled,
            Kind::ImpossibleEdit,
            Kind::ImpossibleValue,
        ],
    },
    array(
        "/v1/sessions/{id}/generations/{generation}/modes",
        "Linear modes, mass-normalised: (n_modes, n_vertices, 3)",
        &[DTYPE],
        SINGLE,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/basis",
        "Basis U with UᵀMU = I: (r, n_vertices, 3)",
        &[DTYPE],
        SINGLE,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/transfer",
        "From an older generation's coordinates to these: (r_new, r_old)",
        &[DTYPE, FROM],
        SINGLE,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/delta",
        "The columns that a holder of an older basis lacks, and W: new = [old | columns] · W",
        &[DTYPE, HAVE],
        SEVERAL,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/combination",
        "The basis as D · W of named blocks of columns that generations share: names, columns in \
         use, W, and the names of the blocks prepared for further edits",
        &[DTYPE],
        SEVERAL,
    ),
    Route {
        problems: &[
            Kind::NotReady,
            Kind::NotAcceptable,
            Kind::TooLarge,
            Kind::ImpossibleValue,
            Kind::NoBlock,
        ],
        ..array(
            "/v1/sessions/{id}/generations/{generation}/dictionary",
            "The columns of some blocks of a combination: (columns, n_vertices, 3)",
            &[DTYPE, BLOCKS],
            SINGLE,
        )
    },
    array(
        "/v1/sessions/{id}/generations/{generation}/evaluator",
        "All that a client needs to evaluate and step the reduced model alone",
        &[DTYPE],
        SEVERAL,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/mass",
        "Lumped mass of each vertex in kg: (n_vertices,)",
        &[DTYPE],
        SINGLE,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/frequencies_hz",
        "Frequencies of the elastic modes in Hz, ascending: (n_modes,)",
        &[DTYPE],
        SINGLE,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/positions",
        "Rest position of each vertex in m, which a closing moves: (n_vertices, 3)",
        &[DTYPE],
        SINGLE,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/tets",
        "Corners of each tet, u32: (n_tets, 4)",
        &[DTYPE],
        SINGLE,
    ),
    array(
        "/v1/sessions/{id}/generations/{generation}/stitches",
        "The stitches in force: their vertices, their names and their stiffness",
        &[DTYPE],
        SEVERAL,
    ),
    evaluation("/v1/sessions/{id}/generations/{generation}/evaluate"),
    evaluation("/v1/sessions/{id}/evaluate"),
    Route {
        method: HttpMethod::Put,
        path: "/v1/sessions/{id}/simulation",
        summary: "Start the session's simulation, or change how it goes on",
        query: &[],
        request: Body::Json("SimulationConfig"),
        status: 200,
        reply: Body::Json("SimulationInfo"),
        problems: &[Kind::NotReady, Kind::ImpossibleSimulation, Kind::ImpossibleValue, Kind::Full],
    },
    Route {
        method: HttpMethod::Get,
        path: "/v1/sessions/{id}/simulation",
        summary: "Describe the session's simulation",
        query: &[],
        request: Body::Empty,
        status: 200,
        reply: Body::Json("SimulationInfo"),
        problems: &[Kind::NoSimulation, Kind::ImpossibleSimulation],
    },
    Route {
        method: HttpMethod::Delete,
        path: "/v1/sessions/{id}/simulation",
        summary: "End the session's simulation",
        query: &[],
        request: Body::Empty,
        status: 204,
        reply: Body::Empty,
        problems: &[Kind::NoSimulation],
    },
    Route {
        method: HttpMethod::Post,
        path: "/v1/sessions/{id}/simulation/forces",
        summary: "Let forces act on vertices for some time",
        query: &[],
        request: Body::Json("ForceRequest"),
        status: 204,
        reply: Body::Empty,
        problems: &[Kind::NoSimulation, Kind::ImpossibleValue],
    },
    Route {
        method: HttpMethod::Post,
        path: "/v1/sessions/{id}/simulation/grabs",
        summary: "Take hold of vertices, move what holds on, and let go",
        query: &[],
        request: Body::Json("GrabRequest"),
        status: 204,
        reply: Body::Empty,
        problems: &[Kind::NoSimulation, Kind::ImpossibleValue, Kind::Full],
    },
    Route {
        method: HttpMethod::Get,
        path: "/v1/sessions/{id}/stream",
        summary: "Receive published states: one binary WebSocket message each",
        query: &[],
        request: Body::Empty,
        status: 101,
        reply: Body::Bytes(&[STATE]),
        problems: &[Kind::UpgradeRequired],
    },
    operation("/", "The viewer, a page", &["text/html"], &[]),
    operation("/healthz", "Whether the process answers", &["text/plain"], &[]),
    operation("/readyz", "Whether new work is welcome", &["text/plain"], &[Kind::ShuttingDown]),
    operation("/metrics", "Measurements in Prometheus' text format", &["text/plain"], &[]),
    operation("/openapi.json", "This description", &[JSON], &[]),
];

/// A route that serves arrays.
const fn array(
    path: &'static str,
    summary: &'static str,
    query: &'static [(&'static str, &'static str)],
    media: &'static [&'static str],
) -> Route {
    Route {
        method: HttpMethod::Get,
        path,
        summary,
        query,
        request: Body::Empty,
        status: 200,
        reply: Body::Bytes(media),
        problems: &[Kind::NotReady, Kind::NotAcceptable, Kind::TooLarge, Kind::ImpossibleValue],
    }
}

const SINGLE: &[&str] = &[NPY, FRAME];
const SEVERAL: &[&str] = &[FRAME];
const DTYPE: (&str, &str) = ("dtype", "f32 (default) or f64");
const FROM: (&str, &str) = ("from", "the older generation; by default the previous one");
const BLOCKS: (&str, &str) =
    ("blocks", "names of the blocks, between commas, as the combination has them (required)");
const HAVE: (&str, &str) = ("have", "the older generation that the client holds (required)");

const fn evaluation(path: &'static str) -> Route {
    Route {
        method: HttpMethod::Post,
        path,
        summary: "Energy, force and tangent stiffness of the reduced model",
        query: &[],
        request: Body::Json("EvaluateRequest"),
        status: 200,
        reply: Body::Json("EvaluateReply"),
        problems: &[Kind::NotReady, Kind::ImpossibleValue],
    }
}

const fn operation(
    path: &'static str,
    summary: &'static str,
    media: &'static [&'static str],
    problems: &'static [Kind],
) -> Route {
    Route {
        method: HttpMethod::Get,
        path,
        summary,
        query: &[],
        request: Body::Empty,
        status: 200,
        reply: Body::Bytes(media),
        problems,
    }
}

impl Route {
    fn operation(&self) -> Operation {
        let path_params = self.path.split(['{', '}']).skip(1).step_by(2).map(path_param);
        let query_params = self.query.iter().map(|(name, meaning)| query_param(name, meaning));
        let mut operation = OperationBuilder::new()
            .summary(Some(self.summary))
            .parameters(Some(path_params.chain(query_params)))
            .request_body(self.request.request())
            .response(self.status.to_string(), self.reply.response());
        for (status, kinds) in self.problems() {
            operation = operation.response(status.to_string(), problem_response(&kinds));
        }
        operation.build()
    }

    /// Every problem of this route, by status.
    fn problems(&self) -> BTreeMap<u16, Vec<Kind>> {
        let mut kinds = self.problems.to_vec();
        if self.path.starts_with("/v1") {
            kinds.extend([
                Kind::Unauthorized,
                Kind::Forbidden,
                Kind::TooOften,
                Kind::Busy,
                Kind::StorageFailed,
            ]);
        }
        if self.path.contains("{id}") {
            kinds.extend([Kind::NoSession, Kind::SessionTaken]);
        }
        if self.path.contains("{generation}") {
            kinds.extend([Kind::NoGeneration, Kind::MalformedParameter]);
        }
        if self.method != HttpMethod::Get {
            kinds.push(Kind::StorageFull);
        }
        if !matches!(self.request, Body::Empty) {
            kinds.extend([
                Kind::MalformedDocument,
                Kind::ReceiveTimeout,
                Kind::TooLarge,
                Kind::UnsupportedMediaType,
            ]);
        }
        let mut by_status = BTreeMap::<u16, Vec<Kind>>::new();
        for kind in kinds {
            by_status.entry(kind.status()).or_default().push(kind);
        }
        by_status
    }
}

impl Body {
    fn request(&self) -> Option<RequestBody> {
        let body = RequestBodyBuilder::new().required(Some(Required::True));
        match self {
            Body::Empty => None,
            Body::Json(schema) => Some(body.content(JSON, document_content(schema)).build()),
            Body::Upload => {
                let parts = ObjectBuilder::new()
                    .property("mesh", bytes_schema())
                    .required("mesh")
                    .property("config", Ref::from_schema_name("SessionConfig"))
                    .required("config");
                Some(
                    body.content(JSON, document_content("SessionConfig"))
                        .content("multipart/form-data", Content::new(Some(parts)))
                        .build(),
                )
            }
            Body::Bytes(media) => {
                Some(media.iter().fold(body, |b, m| b.content(*m, bytes_content())).build())
            }
        }
    }

    fn response(&self) -> Response {
        let response = ResponseBuilder::new();
        match self {
            Body::Empty | Body::Upload => response.description("Done"),
            Body::Json(schema) => {
                response.description(*schema).content(JSON, document_content(schema))
            }
            Body::Bytes(media) => {
                media.iter().fold(response.description(media.join(" or ")), |r, m| {
                    r.content(*m, bytes_content())
                })
            }
        }
        .build()
    }
}

fn document_content(schema: &str) -> Content {
    Content::new(Some(Ref::from_schema_name(schema)))
}

fn bytes_content() -> Content {
    Content::new(Some(bytes_schema()))
}

fn bytes_schema() -> ObjectBuilder {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)))
}

fn problem_response(kinds: &[Kind]) -> Response {
    let titles: Vec<&str> = kinds.iter().map(|kind| kind.title()).collect();
    ResponseBuilder::new()
        .description(titles.join("; "))
        .content(PROBLEM_JSON, document_content("Problem"))
        .build()
}

fn path_param(name: &str) -> Parameter {
    ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Path)
        .required(Required::True)
        .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
        .build()
}

fn query_param(name: &str, meaning: &str) -> Parameter {
    ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Query)
        .required(Required::False)
        .description(Some(meaning))
        .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
        .build()
}
