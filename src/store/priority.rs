//! Who goes first where threads want the same processor: stepping and edits, before builds.

/// Nice level of the threads that builds compute on: under load they get about a tenth of what the
/// others get, and everything that is left over.
#[cfg(target_os = "linux")]
const PATIENCE: i32 = 10;

/// Threads for parallel work, one for each core, that leave the processor to whatever else wants it, where
/// the system has priorities for threads (Linux). `None` if there is no room for so many threads.
pub(crate) fn patient_threads() -> Option<rayon::ThreadPool> {
    let threads = rayon::ThreadPoolBuilder::new()
        .thread_name(|index| format!("patient-{index}"))
        .start_handler(|_| be_patient())
        .build();
    threads.inspect_err(|error| tracing::warn!(%error, "builds compute as edits do")).ok()
}

/// Lets the other threads go before this one.
fn be_patient() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::nice(PATIENCE) {
        tracing::debug!(%error, "builds compute with the priority of edits");
    }
}
