//! Fill-reducing orderings: nested dissection (George, SIAM J. Numer. Anal. 10, 1973) by multilevel node
//! bisection (Karypis and Kumar, SIAM J. Sci. Comput. 20, 1998).
//!
//! The steps of a bisection are those of feral-metis, in pure Rust: METIS itself replaces the process's signal
//! handlers while it runs. The recursion is ours, so that the sides of a separator are ordered side by side and
//! the largest separators, which decide the cost of a factorization, are the better of two. Measured against
//! feral-scotch with its own recursion, on four bodies of 11 000 to 55 000 vertices: seven to eight tenths of the time,
//! 4 to 9 % fewer operations.

use super::FactorizationError;
use crate::assembly::sparse::Pattern;
use feral_metis::MetisOptions;
use feral_metis::internals::coarsen::{CoarsenCounters, coarsen};
use feral_metis::internals::fm_refine::{PART_SEP, refine_bisection, refine_separator_fm};
use feral_metis::internals::graph::Graph;
use feral_metis::internals::initial_partition::{
    PART_A, PART_B, initial_bisect_bfs, initial_bisect_ggp,
};
use feral_metis::internals::rng::SplitMix;
use feral_metis::internals::separator::construct_separator;
use feral_metis::{CscPattern, OrderingError};
use rayon::prelude::*;

/// Graphs up to this size are ordered by minimum degree: 200 costs 5 to 30 % more time and saves 1 to 4 % of the
/// operations; 800 takes a tenth less time than 400 and costs 4 to 10 % more operations.
const DISSECTED_FROM: usize = 300;

/// Bisections are nested this deep at most; a graph that cannot be dissected must not exhaust the stack.
const MOST_LEVELS: usize = 64;

/// Of so many levels separators are the better of two: the first costs nothing, as the other thread has nothing
/// else to do. More levels or more trials gain less than 2 % of the operations and cost a third more time.
const LEVELS_WITH_TRIALS: usize = 2;

/// A side may be this much heavier than half.
const MOST_IMBALANCE: f64 = 0.1;

/// Size of the coarsest graphs. Of 60 to 400 this is the best on two of four bodies (2 and 4 % fewer operations
/// than 100) and within 1 % on the others.
const COARSEST: u32 = 200;

/// First bisections of a coarsest graph, of which the least cut is refined; 3 and 12 make no difference that shows.
const FIRST_BISECTIONS: usize = 6;

/// Passes of a refinement at most; few take more.
const PASSES: u32 = 10;

/// A nested-dissection order of the vertices (new → old), checked to be a permutation.
///
/// Ordering vertices and expanding by three gives the fill of ordering degrees of freedom in a
/// third of the time; minimum degree alone costs five times the flops on solids.
pub(super) fn nested_dissection(pattern: &Pattern) -> Result<Vec<usize>, FactorizationError> {
    let n = pattern.n();
    if i32::try_from(pattern.n_entries()).is_err() {
        return Err(FactorizationError::TooLarge);
    }
    let mut start = Vec::with_capacity(n + 1);
    start.push(0);
    let mut neighbours = Vec::with_capacity(pattern.n_entries());
    for v in 0..n {
        neighbours.extend(pattern.row(v).iter().filter(|&&w| w as usize != v).map(|&w| w as i32));
        start.push(neighbours.len() as i32);
    }
    let failed = |what: &str| FactorizationError::Ordering(what.into());
    let part = Part { graph: unweighted(start, neighbours), vertices: (0..n as u32).collect() };
    let order = part.order(0).map_err(|error| failed(&format!("{error:?}")))?;
    let mut seen = vec![false; n];
    for &v in &order {
        match seen.get_mut(v as usize) {
            Some(seen) if !*seen => *seen = true,
            _ => return Err(failed("not a permutation")),
        }
    }
    if order.len() != n {
        return Err(failed("not a permutation"));
    }
    Ok(order.into_iter().map(|v| v as usize).collect())
}

/// A graph whose vertices and edges count the same.
fn unweighted(xadj: Vec<i32>, adjncy: Vec<i32>) -> Graph {
    let n = xadj.len() - 1;
    let adjwgt = vec![1; adjncy.len()];
    Graph { nvtxs: n as i32, xadj, adjncy, vwgt: vec![1; n], adjwgt }
}

/// A part of the graph.
struct Part {
    graph: Graph,
    /// Of the whole graph.
    vertices: Vec<u32>,
}

impl Part {
    fn n(&self) -> usize {
        self.vertices.len()
    }

    /// Its vertices in order; `level` separators have been taken out of the whole.
    fn order(self, level: usize) -> Result<Vec<u32>, OrderingError> {
        if self.n() <= DISSECTED_FROM || level >= MOST_LEVELS {
            return self.minimum_degree();
        }
        let (component, n_components) = self.components();
        if n_components > 1 {
            return order_each(self.split(&component, n_components), level + 1);
        }
        let side = self.bisect(level);
        let sides = self.split(&side, 2);
        if sides.iter().any(|side| side.n() == 0) {
            return self.minimum_degree();
        }
        let mut order = order_each(sides, level + 1)?;
        order.extend(self.vertices.iter().zip(side).filter(|(_, side)| *side > 1).map(|(v, _)| v));
        Ok(order)
    }

    fn minimum_degree(&self) -> Result<Vec<u32>, OrderingError> {
        let graph = &self.graph;
        let mut sorted = graph.adjncy.clone();
        for v in 0..self.n() {
            sorted[graph.xadj[v] as usize..graph.xadj[v + 1] as usize].sort_unstable();
        }
        let pattern = CscPattern::new(self.n(), &graph.xadj, &sorted);
        let order = feral_amd::amd_order(&pattern.ok_or(OrderingError::MalformedInput)?)?;
        Ok(order.into_iter().map(|v| self.vertices[v as usize]).collect())
    }

    /// The component of each vertex, and how many there are.
    fn components(&self) -> (Vec<u32>, usize) {
        let mut component = vec![u32::MAX; self.n()];
        let mut count = 0;
        let mut waiting = Vec::new();
        for first in 0..self.n() {
            if component[first] != u32::MAX {
                continue;
            }
            component[first] = count;
            waiting.push(first as i32);
            while let Some(v) = waiting.pop() {
                for &w in self.graph.neighbors(v) {
                    let component = &mut component[w as usize];
                    if *component == u32::MAX {
                        *component = count;
                        waiting.push(w);
                    }
                }
            }
            count += 1;
        }
        (component, count as usize)
    }

    /// The `count` parts that `label` tells; vertices with other labels are left out.
    fn split(&self, label: &[u32], count: usize) -> Vec<Part> {
        let mut members = vec![Vec::new(); count];
        let mut local = vec![0; self.n()];
        for (v, &label) in label.iter().enumerate() {
            if let Some(members) = members.get_mut(label as usize) {
                local[v] = members.len() as i32;
                members.push(v);
            }
        }
        let part = |(which, members): (usize, Vec<usize>)| {
            let mut xadj = Vec::with_capacity(members.len() + 1);
            xadj.push(0);
            let mut adjncy = Vec::new();
            for &v in &members {
                let inside = self.graph.neighbors(v as i32).iter().map(|&w| w as usize);
                let inside = inside.filter(|&w| label[w] as usize == which);
                adjncy.extend(inside.map(|w| local[w]));
                xadj.push(adjncy.len() as i32);
            }
            let vertices = members.into_iter().map(|v| self.vertices[v]).collect();
            Part { graph: unweighted(xadj, adjncy), vertices }
        };
        members.into_par_iter().enumerate().map(part).collect()
    }

    /// 0 or 1 for each vertex of a side, 2 for the separator between them.
    fn bisect(&self, level: usize) -> Vec<u32> {
        let n_trials = if level < LEVELS_WITH_TRIALS { 2u32 } else { 1 };
        let found: Vec<Vec<u8>> = (0..n_trials)
            .into_par_iter()
            .with_max_len(1)
            .map(|trial| bisection(&self.graph, u64::from(trial)))
            .collect();
        let separator =
            |labels: &Vec<u8>| labels.iter().filter(|&&label| label == PART_SEP).count();
        let best = found.into_iter().min_by_key(separator).unwrap_or_default();
        let side = |label| match label {
            PART_A => 0,
            PART_B => 1,
            _ => 2,
        };
        best.into_iter().map(side).collect()
    }
}

/// The vertices of each part in order, parts one after the other.
fn order_each(parts: Vec<Part>, level: usize) -> Result<Vec<u32>, OrderingError> {
    let parts = parts.into_par_iter().with_max_len(1);
    let orders: Result<Vec<Vec<u32>>, OrderingError> =
        parts.map(|part| part.order(level)).collect();
    Ok(orders?.concat())
}

/// The label of each vertex: a side or the separator. The graph is made coarser by matching neighbours, bisected, and
/// the separator of the coarsest graph is carried back and refined on the way.
fn bisection(graph: &Graph, seed: u64) -> Vec<u8> {
    let options = MetisOptions { coarsen_floor: COARSEST, ..MetisOptions::default() };
    let mut random = SplitMix::new(seed);
    let levels = coarsen(graph, &options, &mut random, &mut CoarsenCounters::default());
    let coarsest = levels.last().map_or(graph, |level| &level.graph);
    let half = coarsest.vwgt.iter().map(|&weight| i64::from(weight)).sum::<i64>() / 2;
    let first = |trial: usize| {
        let mut labels = match trial % 2 {
            0 => initial_bisect_ggp(coarsest, &mut random, half),
            _ => initial_bisect_bfs(coarsest, &mut random, half),
        };
        (refine_bisection(coarsest, &mut labels, MOST_IMBALANCE, PASSES), labels)
    };
    let least = (0..FIRST_BISECTIONS).map(first).min_by_key(|(cut, _)| *cut);
    let mut labels = least.map(|(_, labels)| labels).unwrap_or_default();
    construct_separator(coarsest, &mut labels);
    refine_separator_fm(coarsest, &mut labels, MOST_IMBALANCE, PASSES);
    for (index, level) in levels.iter().enumerate().rev() {
        let finer = index.checked_sub(1).map_or(graph, |finer| &levels[finer].graph);
        labels = level.cmap.iter().map(|&coarse| labels[coarse as usize]).collect();
        refine_separator_fm(finer, &mut labels, MOST_IMBALANCE, PASSES);
    }
    labels
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grids side by side, and vertices by themselves.
    fn pattern(grids: &[u32], alone: u32) -> Pattern {
        let (mut first, mut pairs) = (0, Vec::new());
        for &m in grids {
            for at in 0..m * m * m {
                for (step, ends) in [(1, at % m == m - 1), (m, at / m % m == m - 1), (m * m, false)]
                {
                    if !ends && at + step < m * m * m {
                        pairs.push([first + at, first + at + step]);
                    }
                }
            }
            first += m * m * m;
        }
        Pattern::new((first + alone) as usize, &[], &pairs)
    }

    #[test]
    fn every_vertex_is_ordered_once_and_separators_come_last() {
        let order = nested_dissection(&pattern(&[14], 0)).unwrap();
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..14 * 14 * 14));
        // Without the last plane's worth of vertices the grid falls apart.
        let m = 14;
        let kept: Vec<bool> = {
            let mut kept = vec![true; m * m * m];
            order[m * m * m - 5 * m * m / 4..].iter().for_each(|&v| kept[v] = false);
            kept
        };
        let reached = |first: usize| {
            let pattern = pattern(&[14], 0);
            let (mut seen, mut waiting) = (vec![false; m * m * m], vec![first]);
            seen[first] = true;
            while let Some(v) = waiting.pop() {
                for &w in pattern.row(v) {
                    let w = w as usize;
                    if kept[w] && !seen[w] {
                        seen[w] = true;
                        waiting.push(w);
                    }
                }
            }
            seen.into_iter().filter(|seen| *seen).count()
        };
        let largest = (0..m * m * m).filter(|&v| kept[v]).map(reached).max().unwrap();
        assert!(largest < 7 * m * m * m / 10, "{largest}");
    }

    #[test]
    fn pieces_that_do_not_touch_are_ordered_too() {
        for (grids, alone) in [(&[9, 3, 9][..], 40), (&[], 700), (&[2], 0), (&[], 0)] {
            let pattern = pattern(grids, alone);
            let mut order = nested_dissection(&pattern).unwrap();
            order.sort_unstable();
            assert!(order.into_iter().eq(0..pattern.n()));
        }
    }

    #[test]
    fn a_hub_is_ordered_without_exhausting_the_stack() {
        let pairs: Vec<[u32; 2]> = (1..20_000).map(|v| [0, v]).collect();
        let order = nested_dissection(&Pattern::new(20_000, &[], &pairs)).unwrap();
        assert_eq!(order.len(), 20_000);
        // Eliminated before the others, it would couple them all.
        assert!(order[20_000 - 2..].contains(&0));
    }
}
