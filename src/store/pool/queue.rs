//! A queue that is fair between accounts (start-time fair queueing; Goyal, Vin, Cheng 1996).
//!
//! Each account has a line of its own, in the order of arrival, and a tag: the service in s that it has
//! had. The next task is of the line with the lowest tag, the oldest where tags are equal. A line that
//! was empty begins at the tag of whoever was served last, so that nobody saves up time by not using it.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use crate::session::SessionId;

/// Whose turn a task takes.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Account {
    /// The store's own work, and that of callers nobody has asked for a name.
    Common,
    /// A session that belongs to no tenant.
    Session(SessionId),
    /// Every session of a tenant together.
    Tenant(Arc<str>),
}

impl Account {
    /// The tenant's; the common one where nobody is asked.
    pub fn of(tenant: Option<&str>) -> Account {
        tenant.map_or(Account::Common, |tenant| Account::Tenant(tenant.into()))
    }
}

struct Line<T> {
    /// With the number of its arrival.
    tasks: VecDeque<(u64, T)>,
    tag_s: f64,
    n_running: usize,
}

/// What waits in one class.
pub(super) struct FairQueue<T> {
    /// Only accounts with tasks that wait or run.
    lines: BTreeMap<Account, Line<T>>,
    /// The tag of whoever was served last.
    now_s: f64,
    n_arrivals: u64,
    n_waiting: usize,
}

impl<T> FairQueue<T> {
    pub(super) fn new() -> Self {
        Self { lines: BTreeMap::new(), now_s: 0.0, n_arrivals: 0, n_waiting: 0 }
    }

    /// Tasks that wait.
    pub(super) fn len(&self) -> usize {
        self.n_waiting
    }

    /// Whether `account` may add a task to a queue of `limit` places: an account may take as many as it
    /// leaves free (dynamic thresholds; Choudhury, Hahne 1998), so that whoever comes new finds room.
    pub(super) fn has_room(&self, account: &Account, limit: usize) -> bool {
        let n_own = self.lines.get(account).map_or(0, |line| line.tasks.len());
        n_own < limit.saturating_sub(self.n_waiting)
    }

    /// Tasks that go before one that `account` adds now, if all take equally long.
    pub(super) fn n_before(&self, account: &Account) -> usize {
        let n_own = self.lines.get(account).map_or(0, |line| line.tasks.len());
        let others = self.lines.iter().filter(|(other, _)| *other != account);
        n_own + others.map(|(_, line)| line.tasks.len().min(n_own + 1)).sum::<usize>()
    }

    pub(super) fn push(&mut self, account: Account, task: T) {
        let tag_s = self.now_s;
        let line = self.lines.entry(account);
        let new = || Line { tasks: VecDeque::new(), tag_s, n_running: 0 };
        line.or_insert_with(new).tasks.push_back((self.n_arrivals, task));
        self.n_arrivals += 1;
        self.n_waiting += 1;
    }

    /// The next task that `may_run`, of which only the oldest of each line that does is looked at. It is
    /// charged `estimate_s` until [`FairQueue::settle`] knows better.
    pub(super) fn pop(
        &mut self,
        estimate_s: f64,
        may_run: impl Fn(&T) -> bool,
    ) -> Option<(Account, T)> {
        let next = self.lines.iter().filter_map(|(account, line)| {
            let at = line.tasks.iter().position(|(_, task)| may_run(task))?;
            Some((line.tag_s, line.tasks[at].0, account, at))
        });
        let (_, _, account, at) =
            next.min_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)))?;
        let account = account.clone();
        let line = self.lines.get_mut(&account)?;
        let (_, task) = line.tasks.remove(at)?;
        self.now_s = self.now_s.max(line.tag_s);
        line.tag_s += estimate_s;
        line.n_running += 1;
        self.n_waiting -= 1;
        Some((account, task))
    }

    /// A task that was charged `estimate_s` has ended after `actual_s`.
    pub(super) fn settle(&mut self, account: &Account, estimate_s: f64, actual_s: f64) {
        if let Some(line) = self.lines.get_mut(account) {
            line.tag_s += actual_s - estimate_s;
            line.n_running -= 1;
        }
        self.forget_idle();
    }

    /// Takes out every task that `is_wanted` refuses.
    pub(super) fn retain(&mut self, is_wanted: impl Fn(&T) -> bool) -> Vec<T> {
        let mut removed = Vec::new();
        // Whoever gives up a task does so often, and mostly one line of many has it.
        let is_touched = |line: &Line<T>| line.tasks.iter().any(|(_, task)| !is_wanted(task));
        for line in self.lines.values_mut().filter(|line| is_touched(line)) {
            let (kept, others) =
                std::mem::take(&mut line.tasks).into_iter().partition(|(_, task)| is_wanted(task));
            line.tasks = kept;
            let others: VecDeque<(u64, T)> = others;
            removed.extend(others.into_iter().map(|(_, task)| task));
        }
        self.n_waiting -= removed.len();
        self.forget_idle();
        removed
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &T> {
        self.lines.values().flat_map(|line| line.tasks.iter().map(|(_, task)| task))
    }

    fn forget_idle(&mut self) {
        self.lines.retain(|_, line| line.n_running > 0 || !line.tasks.is_empty());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tenant(name: &str) -> Account {
        Account::of(Some(name))
    }

    /// Serves everything, one task at a time, each of its own length in s; tells in which order.
    fn serve(queue: &mut FairQueue<(&'static str, f64)>) -> Vec<&'static str> {
        let mut order = Vec::new();
        while let Some((account, (name, took_s))) = queue.pop(1.0, |_| true) {
            queue.settle(&account, 1.0, took_s);
            order.push(name);
        }
        assert_eq!((queue.len(), queue.lines.len()), (0, 0));
        order
    }

    #[test]
    fn a_long_line_does_not_hold_up_a_short_one() {
        let mut queue = FairQueue::new();
        for _ in 0..4 {
            queue.push(tenant("a"), ("a", 1.0));
        }
        queue.push(tenant("b"), ("b", 1.0));
        queue.push(tenant("b"), ("b", 1.0));
        assert_eq!(serve(&mut queue), ["a", "b", "a", "b", "a", "a"]);
    }

    #[test]
    fn what_is_shared_is_time_and_not_turns() {
        let mut queue = FairQueue::new();
        for _ in 0..2 {
            queue.push(tenant("slow"), ("slow", 3.0));
        }
        for _ in 0..6 {
            queue.push(tenant("quick"), ("quick", 1.0));
        }
        let order = serve(&mut queue);
        assert_eq!(order[..5], ["slow", "quick", "quick", "quick", "slow"]);
    }

    #[test]
    fn nobody_saves_up_time_by_staying_away() {
        let mut queue = FairQueue::new();
        queue.push(tenant("a"), ("a", 100.0));
        serve(&mut queue);
        for _ in 0..3 {
            queue.push(tenant("a"), ("a", 1.0));
        }
        let (account, _) = queue.pop(1.0, |_| true).unwrap();
        queue.settle(&account, 1.0, 50.0);
        // Whoever comes now goes next, and once: not for the 50 s that the other has had.
        for _ in 0..2 {
            queue.push(tenant("b"), ("b", 60.0));
        }
        assert_eq!(serve(&mut queue), ["b", "a", "a", "b"]);
    }

    #[test]
    fn an_account_takes_no_more_places_than_it_leaves() {
        let mut queue = FairQueue::new();
        let fill = |queue: &mut FairQueue<()>, account: &Account| {
            let mut n = 0;
            while queue.has_room(account, 12) {
                queue.push(account.clone(), ());
                n += 1;
            }
            n
        };
        assert_eq!(fill(&mut queue, &tenant("a")), 6);
        assert_eq!(fill(&mut queue, &tenant("b")), 3);
        assert_eq!(fill(&mut queue, &tenant("c")), 2);
        assert_eq!(fill(&mut queue, &tenant("d")), 1);
        assert_eq!(fill(&mut queue, &tenant("e")), 0);
        assert_eq!(queue.len(), 12);
    }

    #[test]
    fn tasks_before_a_new_one_are_counted_by_turns() {
        let mut queue = FairQueue::new();
        for (name, n) in [("a", 5), ("b", 2), ("c", 1)] {
            (0..n).for_each(|_| queue.push(tenant(name), ()));
        }
        assert_eq!(queue.n_before(&tenant("new")), 3);
        assert_eq!(queue.n_before(&tenant("c")), 1 + 2 + 2);
        assert_eq!(queue.n_before(&tenant("a")), 5 + 2 + 1);
    }

    #[test]
    fn a_task_that_may_not_run_lets_those_behind_it_pass() {
        let mut queue = FairQueue::new();
        for task in [1, 2, 3] {
            queue.push(tenant("a"), task);
        }
        assert_eq!(queue.pop(1.0, |task| *task != 1).unwrap().1, 2);
        assert_eq!(queue.retain(|task| *task != 3), [3]);
        assert_eq!(queue.iter().copied().collect::<Vec<_>>(), [1]);
        assert_eq!(queue.len(), 1);
    }
}
