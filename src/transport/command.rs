//! The commands that both transports offer: wire request in, wire reply or problem out.

use crate::access::Caller;
use crate::conversion::array::{self, ArrayForm, ArrayKind, Reference};
use crate::conversion::{edit, session, simulation};
use crate::gateway::Gateway;
use crate::problem::{Kind, Problem, of_build};
use std::sync::Arc;
use std::time::Instant;
use sutura_core::mesh::MeshLimits;
use sutura_proto::array::DType;
use sutura_proto::edit::{EditReply, EditRequest};
use sutura_proto::generation::{
    MAX_DICTIONARY_BLOCKS, PARAMETER_BLOCKS, PARAMETER_DTYPE, PARAMETER_FROM, PARAMETER_HAVE,
};
use sutura_proto::session::{SeamReply, SeamRequest, SessionInfo};
use sutura_proto::simulation::{ForceRequest, GrabRequest};
use sutura_store::{Account, Generation, GenerationRef, SessionId};

/// What a client wrote, quoted and cut to what fits into a sentence.
fn shown(text: &str) -> String {
    let cut: String = text.chars().take(64).collect();
    format!("{cut:?}")
}

/// The session that `text` names.
pub(crate) fn session_id(text: &str) -> Result<SessionId, Problem> {
    text.parse()
        .map_err(|_| Problem::new(Kind::NoSession, format!("there is no session {}", shown(text))))
}

/// The generation that `text` names: a number, or `current`.
pub(crate) fn generation_ref(text: &str) -> Result<GenerationRef, Problem> {
    match text {
        "current" => Ok(GenerationRef::Current),
        number => number.parse().map(GenerationRef::Number).map_err(|_| {
            Problem::new(
                Kind::MalformedParameter,
                "a generation is named by its number, or \"current\"",
            )
        }),
    }
}

/// Documents beyond this many bytes are parsed on the query pool: at some 100 MB/s, below it a
/// document takes less than half a millisecond.
const PARSE_AT_ONCE_BYTES: usize = 32 << 10;

/// Runs `parse` on a document of `n_bytes`, on the query pool if it is large.
pub(crate) async fn parse<T: Send + 'static>(
    gateway: &Gateway,
    account: Account,
    n_bytes: usize,
    parse: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    if n_bytes <= PARSE_AT_ONCE_BYTES {
        return parse();
    }
    gateway.store().compute(account, "parsing a document", move |_| parse()).await?
}

/// What is known of a session now.
pub(crate) fn info(gateway: &Gateway, id: SessionId) -> Result<SessionInfo, Problem> {
    Ok(session::info(&gateway.store().info(id)?))
}

/// The sessions that `caller` may see: at most `limit`, beginning behind `after`.
pub(crate) fn list(
    gateway: &Gateway,
    caller: &Caller,
    after: Option<SessionId>,
    limit: usize,
) -> Vec<sutura_store::SessionInfo> {
    match caller.tenant() {
        Some(tenant) => gateway.store().list_of(tenant, after, limit),
        None => gateway.store().list(after, limit),
    }
}

/// Opens a session from what a client uploaded.
pub(crate) async fn create(
    gateway: &Gateway,
    caller: &Caller,
    upload: session::Upload,
) -> Result<SessionId, Problem> {
    let limits = &gateway.store().config().limits;
    let limits = MeshLimits { max_vertices: limits.max_vertices, max_tets: limits.max_tets };
    let mut request = gateway
        .store()
        .compute(caller.account(), "reading a mesh", move |_| session::create(upload, &limits))
        .await??;
    request.tenant = caller.tenant().map(|tenant| tenant.to_string());
    Ok(gateway.store().create(request).await?)
}

/// Makes the next generation. Dropping the future cancels the edit.
pub(crate) async fn edit(
    gateway: &Gateway,
    id: SessionId,
    request: EditRequest,
) -> Result<EditReply, Problem> {
    let begun = Instant::now();
    let request = edit::request(request)?;
    let method = request.method;
    let generation = gateway.store().edit(id, request).await?;
    Ok(edit::reply(&generation, method, begun.elapsed()))
}

/// Names candidate pairs.
pub(crate) async fn add_seams(
    gateway: &Gateway,
    id: SessionId,
    request: SeamRequest,
) -> Result<SeamReply, Problem> {
    request.validate()?;
    let added = gateway.store().add_seams(id, request.pairs).await;
    let n_pairs = added.map_err(|error| of_build(&error).moved("/seams", "/pairs"))?;
    let info = gateway.store().info(id)?;
    let body = info.generation.as_ref().map(|generation| &generation.artifacts);
    Ok(SeamReply { n_pairs, n_prepared_pairs: body.map_or(0, |body| body.n_prepared_pairs()) })
}

/// Lets forces act on a running simulation.
pub(crate) fn push_forces(
    gateway: &Gateway,
    id: SessionId,
    request: ForceRequest,
) -> Result<(), Problem> {
    Ok(gateway.store().push_forces(id, simulation::forces(request)?)?)
}

/// Takes hold of vertices of a running simulation, moves what holds on, and lets go.
pub(crate) fn grab(gateway: &Gateway, id: SessionId, request: GrabRequest) -> Result<(), Problem> {
    let (grabs, release) = simulation::grabs(request)?;
    Ok(gateway.store().grab(id, grabs, release)?)
}

/// Which array of which generation, and how it is to travel.
#[derive(Clone, Debug)]
pub(crate) struct ArrayRequest {
    pub(crate) kind: ArrayKind,
    pub(crate) generation: GenerationRef,
    pub(crate) params: ArrayParams,
    pub(crate) media: &'static str,
    /// Largest array that may be sent.
    pub(crate) max_bytes: usize,
}

/// An array of a generation as bytes.
pub(crate) async fn array(
    gateway: &Gateway,
    id: SessionId,
    request: ArrayRequest,
) -> Result<Vec<u8>, Problem> {
    let ArrayRequest { kind, params, media, max_bytes, .. } = request;
    let form = ArrayForm { dtype: params.dtype, media, max_bytes };
    check_blocks(kind, &params.blocks)?;
    let generation = gateway.store().fetch(id, request.generation).await?;
    let reference = reference(gateway, id, kind, &generation, &params)?;
    let job = move |control: &dyn sutura_core::control::Control| {
        array::encode(kind, &generation, reference.as_deref(), &params.blocks, form, control)
    };
    let account = gateway.store().account(id)?;
    gateway.store().compute(account, "assembling an array", job).await?
}

/// Whether `blocks` name some where that is wanted, and none elsewhere.
fn check_blocks(kind: ArrayKind, blocks: &[u64]) -> Result<(), Problem> {
    let detail = match (kind, blocks) {
        (ArrayKind::Dictionary, []) => "say which blocks with ?blocks=",
        (ArrayKind::Dictionary, _) | (_, []) => return Ok(()),
        _ => "?blocks= does not belong to this array",
    };
    Err(Problem::new(Kind::MalformedParameter, detail))
}

/// The second generation that the array relates to, if it relates to one.
fn reference(
    gateway: &Gateway,
    id: SessionId,
    kind: ArrayKind,
    generation: &Generation,
    params: &ArrayParams,
) -> Result<Option<Arc<Generation>>, Problem> {
    let misplaced = |name| {
        let detail = format!("?{name}= does not belong to this array");
        Err(Problem::new(Kind::MalformedParameter, detail))
    };
    let number = match (kind.reference(), params.from, params.have) {
        (Reference::PreviousUnlessGiven, from, None) => match from {
            Some(number) => number,
            None => generation.number.checked_sub(1).ok_or_else(|| {
                let detail = "generation 0 has no previous one: name another with ?from=";
                Problem::new(Kind::NoGeneration, detail)
            })?,
        },
        (Reference::Required, None, Some(number)) => number,
        (Reference::Required, None, None) => {
            let detail = "say which generation the client holds with ?have=";
            return Err(Problem::new(Kind::MalformedParameter, detail));
        }
        (Reference::None, None, None) => return Ok(None),
        (_, Some(_), _) => return misplaced("from"),
        (_, None, Some(_)) => return misplaced("have"),
    };
    Ok(Some(gateway.store().generation(id, GenerationRef::Number(number))?))
}

/// Parameters of an array request, from an HTTP query or a Zenoh selector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ArrayParams {
    /// Element type of floating-point arrays.
    pub(crate) dtype: DType,
    /// `transfer`: the generation whose coordinates it takes.
    pub(crate) from: Option<u64>,
    /// `delta`: the generation that the client holds.
    pub(crate) have: Option<u64>,
    /// `dictionary`: names of blocks, none of them twice.
    pub(crate) blocks: Vec<u64>,
}

impl ArrayParams {
    /// Reads every pair; refuses names and values it does not know.
    pub(crate) fn parse<'a>(
        pairs: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<ArrayParams, Problem> {
        let malformed = |detail: String| Problem::new(Kind::MalformedParameter, detail);
        let number = |name: &str, text: &str| {
            text.parse().map(Some).map_err(|_| malformed(format!("{name} must be a number")))
        };
        let mut params =
            ArrayParams { dtype: DType::F32, from: None, have: None, blocks: Vec::new() };
        for (name, value) in pairs {
            match (name, value) {
                (PARAMETER_DTYPE, "f32") => params.dtype = DType::F32,
                (PARAMETER_DTYPE, "f64") => params.dtype = DType::F64,
                (PARAMETER_DTYPE, other) => {
                    return Err(malformed(format!(
                        "dtype must be f32 or f64, not {}",
                        shown(other)
                    )));
                }
                (PARAMETER_FROM, text) => params.from = number(PARAMETER_FROM, text)?,
                (PARAMETER_HAVE, text) => params.have = number(PARAMETER_HAVE, text)?,
                (PARAMETER_BLOCKS, text) => params.blocks = block_names(text).map_err(malformed)?,
                _ => {
                    return Err(malformed(format!("there is no parameter {}", shown(name))));
                }
            }
        }
        Ok(params)
    }
}

/// Numbers between commas: at most as many as one request may name, each once.
fn block_names(text: &str) -> Result<Vec<u64>, String> {
    let mut names = Vec::new();
    for part in text.split(',') {
        let name = part.parse().map_err(|_| format!("{} is no name of a block", shown(part)))?;
        if names.contains(&name) {
            return Err(format!("block {name} is named twice"));
        }
        if names.len() == MAX_DICTIONARY_BLOCKS {
            return Err(format!("at most {MAX_DICTIONARY_BLOCKS} blocks are sent at once"));
        }
        names.push(name);
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn array_parameters_are_read_strictly() {
        let params = ArrayParams::parse([("dtype", "f64"), ("from", "3")]).unwrap();
        let expected =
            ArrayParams { dtype: DType::F64, from: Some(3), have: None, blocks: Vec::new() };
        assert_eq!(params, expected);
        let params = ArrayParams::parse([("blocks", "7,18446744073709551615,0")]).unwrap();
        assert_eq!(params.blocks, [7, u64::MAX, 0]);
        assert_eq!(ArrayParams::parse([]).unwrap().dtype, DType::F32);
        let numbers: Vec<String> = (0..=MAX_DICTIONARY_BLOCKS).map(|n| n.to_string()).collect();
        assert!(ArrayParams::parse([("blocks", &*numbers[1..].join(","))]).is_ok());
        for pair in [
            ("dtype", "u32"),
            ("from", "-1"),
            ("have", ""),
            ("dtyp", "f64"),
            ("blocks", ""),
            ("blocks", "1,"),
            ("blocks", "1,x"),
            ("blocks", "1,2,1"),
            ("blocks", "18446744073709551616"),
            ("blocks", &*numbers.join(",")),
        ] {
            assert_eq!(ArrayParams::parse([pair]).unwrap_err().status(), 400, "{pair:?}");
        }
    }

    #[test]
    fn generations_are_numbers_or_current() {
        assert_eq!(generation_ref("current").unwrap(), GenerationRef::Current);
        assert_eq!(generation_ref("12").unwrap(), GenerationRef::Number(12));
        for text in ["", "latest", "-1", "1.0", "99999999999999999999999"] {
            assert_eq!(generation_ref(text).unwrap_err().status(), 400, "{text}");
        }
    }

    #[test]
    fn what_names_no_session_is_not_found_and_quoted_briefly() {
        let problem = session_id(&"x".repeat(10_000)).unwrap_err();
        assert_eq!(problem.status(), 404);
        assert!(problem.detail.len() < 100);
    }
}
