//! Everything that one run finds, and how it is run: each part of each body in a process of its own,
//! so that none inherits another's memory.

use crate::accuracy::{self, Accuracies};
use crate::bodies::{Body, Failure};
use crate::cubature::{self, Method};
use crate::edits::{self, Edits};
use crate::kernels::{self, Kernels};
use crate::measure::{Check, Machine};
use crate::peers::{self, Peers, Ratio};
use crate::references::Reference;
use crate::scaling::{self, Scaling};
use crate::session::{self, Session, Sessions, Vega};
use clap::ValueEnum;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What to measure.
#[derive(Clone)]
pub(crate) struct Plan {
    /// Where the bodies are.
    pub(crate) meshes: PathBuf,
    /// Where their references are.
    pub(crate) references: Option<PathBuf>,
    pub(crate) bodies: Vec<String>,
    /// Repetitions of everything.
    pub(crate) repeat: usize,
    /// Most stitches of an edit.
    pub(crate) most_stitches: usize,
    /// Vertices of the largest cube; none if 0.
    pub(crate) most_cube_vertices: usize,
    /// Whether the methods that select cubature points are compared.
    pub(crate) compares_cubature: bool,
    /// Whether every part gets a process of its own (peak memory is wrong otherwise).
    pub(crate) is_apart: bool,
}

/// A piece of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Part {
    Kernels,
    Edits,
    Session,
    SessionOfTets,
    Cubature,
    Accuracy,
    Vega,
    Scaling,
}

/// All parts of one body.
#[derive(Serialize)]
pub(crate) struct BodyResults {
    pub(crate) name: String,
    pub(crate) kernels: Kernels,
    pub(crate) edits: Edits,
    pub(crate) sessions: Sessions,
    /// With cubature points that are not smoothed, which is what peers build.
    pub(crate) sessions_of_tets: Sessions,
    /// Empty unless asked for.
    pub(crate) cubature: Vec<Method>,
}

/// One run.
#[derive(Serialize)]
pub(crate) struct Results {
    pub(crate) machine: Machine,
    pub(crate) repeat: usize,
    pub(crate) bodies: Vec<BodyResults>,
    pub(crate) vega_body: String,
    pub(crate) vega: Option<Vega>,
    pub(crate) scaling: Option<Scaling>,
    pub(crate) peers: Option<Peers>,
    pub(crate) ratios: Vec<Ratio>,
    /// By the body that they belong to.
    pub(crate) checks: Vec<(String, Check)>,
}

impl Plan {
    /// Does one part, here.
    pub(crate) fn part(&self, part: Part, name: &str) -> Result<serde_json::Value, Failure> {
        if part == Part::Scaling {
            let scaling = scaling::measure(self.most_cube_vertices, self.repeat)?;
            return Ok(serde_json::to_value(scaling)?);
        }
        let body = Body::load(&self.meshes, name)?;
        let reference = match &self.references {
            Some(directory) => Reference::load(directory, name)?,
            None => None,
        };
        Ok(match part {
            Part::Kernels => {
                serde_json::to_value(kernels::measure(&body, reference.as_ref(), self.repeat)?)?
            }
            Part::Edits => serde_json::to_value(edits::measure(
                &body,
                reference.as_ref(),
                self.most_stitches,
                self.repeat,
            )?)?,
            Part::Session => serde_json::to_value(session::measure(&body, true)?)?,
            Part::SessionOfTets => serde_json::to_value(session::measure(&body, false)?)?,
            Part::Cubature => serde_json::to_value(cubature::measure(&body)?)?,
            Part::Accuracy => serde_json::to_value(accuracy::measure(&body, self.most_stitches)?)?,
            Part::Vega => serde_json::to_value(session::measure_vega(&body, self.repeat)?)?,
            Part::Scaling => unreachable!("answered above"),
        })
    }

    /// Does one part, in another process (this program again) if parts are to be apart.
    fn answer<T: DeserializeOwned>(&self, part: Part, name: &str) -> Result<T, Failure> {
        if !self.is_apart {
            return Ok(serde_json::from_value(self.part(part, name)?)?);
        }
        eprintln!("{name}: {part:?}");
        let mut command = Command::new(std::env::current_exe()?);
        let part_name = part.to_possible_value().ok_or("a part without a name")?;
        command.args(["--child", part_name.get_name(), "--bodies", name]);
        command.arg("--meshes").arg(&self.meshes);
        command.args(["--repeat", &self.repeat.to_string()]);
        command.args(["--stitches", &self.most_stitches.to_string()]);
        command.args(["--cubes", &self.most_cube_vertices.to_string()]);
        if let Some(references) = &self.references {
            command.arg("--references").arg(references);
        }
        let output = command.stderr(Stdio::inherit()).output()?;
        if !output.status.success() {
            return Err(format!("{name}: {part:?} failed ({})", output.status).into());
        }
        Ok(serde_json::from_slice(&output.stdout)?)
    }

    /// How good rebuilt bases are, and nothing else.
    pub(crate) fn run_accuracy(&self) -> Result<Accuracies, Failure> {
        let bodies = self.bodies.iter().map(|name| self.answer(Part::Accuracy, name));
        Ok(Accuracies::of(bodies.collect::<Result<_, _>>()?))
    }

    /// Does everything else. Each body's peers run right before it with the interpreter `python`, if there is one, their
    /// results in `folder`: a machine that others share is fast in one half hour and slow in the next.
    pub(crate) fn run(&self, python: Option<&Path>, folder: &Path) -> Result<Results, Failure> {
        let machine = Machine::here();
        let mut bodies = Vec::new();
        let mut peers: Option<Peers> = None;
        for name in &self.bodies {
            if let Some(python) = python {
                let found = Peers::measure(python, self, name, folder)?;
                peers = Some(match peers {
                    Some(others) => others.with(found),
                    None => found,
                });
            }
            let kernels = self.answer(Part::Kernels, name)?;
            let sessions = |part: Part| -> Result<Sessions, Failure> {
                let all: Vec<Session> =
                    (0..self.repeat).map(|_| self.answer(part, name)).collect::<Result<_, _>>()?;
                Ok(Sessions::of(all).ok_or("at least one repetition is needed")?)
            };
            bodies.push(BodyResults {
                name: name.clone(),
                kernels,
                sessions_of_tets: sessions(Part::SessionOfTets)?,
                sessions: sessions(Part::Session)?,
                edits: self.answer(Part::Edits, name)?,
                cubature: match self.compares_cubature {
                    true => self.answer(Part::Cubature, name)?,
                    false => Vec::new(),
                },
            });
        }
        let vega_body = self.bodies.iter().find(|name| name.starts_with("stomach"));
        let vega = vega_body.map(|name| self.answer(Part::Vega, name)).transpose()?;
        let scaling = match self.most_cube_vertices {
            0 => None,
            _ => Some(self.answer(Part::Scaling, "cubes")?),
        };
        let mut results = Results {
            machine,
            repeat: self.repeat,
            bodies,
            vega_body: vega_body.cloned().unwrap_or_default(),
            vega,
            scaling,
            peers: None,
            ratios: Vec::new(),
            checks: Vec::new(),
        };
        results.judge(peers);
        Ok(results)
    }
}

impl Results {
    /// Gathers every check and compares with the peers.
    pub(crate) fn judge(&mut self, peers: Option<Peers>) {
        let mut checks = Vec::new();
        for body in &self.bodies {
            let own = body.kernels.checks.iter().chain(&body.edits.checks);
            checks.extend(own.map(|check| (body.name.clone(), check.clone())));
        }
        if let Some(vega) = &self.vega {
            let name = format!("{}, welded", self.vega_body);
            checks.extend(vega.checks.iter().map(|check| (name.clone(), check.clone())));
        }
        if let Some(scaling) = &self.scaling {
            checks.extend(scaling.checks.iter().map(|check| ("cubes".into(), check.clone())));
        }
        checks.extend(peers.iter().flat_map(|peers| peers::checks(self, peers)));
        self.checks = checks;
        self.ratios = peers::ratios(self, peers.as_ref());
        self.peers = peers;
    }

    /// The checks that do not hold.
    pub(crate) fn wrong(&self) -> Vec<&(String, Check)> {
        self.checks.iter().filter(|(_, check)| !check.holds()).collect()
    }
}
