//! Evaluation requests and replies.

use crate::problem::{Kind, Problem};
use sutura_core::reduced::Evaluation;
use sutura_proto::evaluate::{self as wire, Coordinates, EvaluateReply, EvaluateRequest};

/// The poses of a request, and whether they were given one by one.
pub(crate) fn poses(request: EvaluateRequest) -> Result<(Vec<Vec<f64>>, Shape), Problem> {
    request.validate()?;
    Ok(match request.q {
        Coordinates::Single(q) => (vec![q], Shape::Single),
        Coordinates::Batch(batch) => (batch, Shape::Batch),
    })
}

/// Whether a request held one pose or a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    Single,
    Batch,
}

impl Shape {
    /// In the request of a single pose, that pose is `/q` itself.
    pub(crate) fn place(self, problem: Problem) -> Problem {
        let place = match (self, problem.pointer.as_deref().and_then(|p| p.strip_prefix("/q/0"))) {
            (Shape::Single, Some(rest)) => format!("/q{rest}"),
            _ => return problem,
        };
        problem.at(place)
    }
}

/// The answer in the shape of the question.
pub(crate) fn reply(evaluations: Vec<Evaluation>, shape: Shape) -> Result<EvaluateReply, Problem> {
    let mut evaluations: Vec<_> = evaluations.into_iter().map(wire_evaluation).collect();
    match shape {
        Shape::Batch => Ok(EvaluateReply::Batch { evaluations }),
        Shape::Single => evaluations
            .pop()
            .map(EvaluateReply::Single)
            .ok_or_else(|| Problem::new(Kind::Internal, "the evaluation came back empty")),
    }
}

fn wire_evaluation(evaluation: Evaluation) -> wire::Evaluation {
    let Evaluation { energy_j, force, stiffness } = evaluation;
    let r = force.len().max(1);
    let stiffness = stiffness.chunks(r).map(<[f64]>::to_vec).collect();
    wire::Evaluation { energy_j, force, stiffness }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluation(energy_j: f64) -> Evaluation {
        Evaluation { energy_j, force: vec![1.0, 2.0], stiffness: vec![1.0, 2.0, 2.0, 3.0] }
    }

    #[test]
    fn answers_have_the_shape_of_the_question() {
        let (poses, shape) =
            poses(EvaluateRequest { q: Coordinates::Single(vec![1.0]), exact: false }).unwrap();
        assert_eq!((poses, shape), (vec![vec![1.0]], Shape::Single));
        let single = reply(vec![evaluation(1.0)], Shape::Single).unwrap();
        let json = serde_json::to_value(&single).unwrap();
        assert_eq!(json["stiffness"], serde_json::json!([[1.0, 2.0], [2.0, 3.0]]));
        let batch = reply(vec![evaluation(1.0), evaluation(2.0)], Shape::Batch).unwrap();
        assert_eq!(serde_json::to_value(&batch).unwrap()["evaluations"][1]["energy_j"], 2.0);
    }

    #[test]
    fn a_single_pose_is_pointed_at_as_the_request_has_it() {
        let at = |pointer: &str| Problem::new(Kind::ImpossibleValue, "").at(pointer);
        assert_eq!(Shape::Single.place(at("/q/0")).pointer.as_deref(), Some("/q"));
        assert_eq!(Shape::Single.place(at("/q/0/7")).pointer.as_deref(), Some("/q/7"));
        assert_eq!(Shape::Batch.place(at("/q/0/7")).pointer.as_deref(), Some("/q/0/7"));
    }
}
