//! Work on a run folder in several threads.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::run::RunError;

/// Does two things at once, the second in this thread; one after the other if there is to be one job.
///
/// # Errors
/// The system starts no thread.
pub fn both<A: Send, B>(
    jobs: usize,
    other: impl FnOnce() -> A + Send,
    own: impl FnOnce() -> B,
) -> Result<(A, B), RunError> {
    if jobs < 2 {
        return Ok((other(), own()));
    }
    std::thread::scope(|scope| {
        let other = std::thread::Builder::new().spawn_scoped(scope, other);
        let other = other.map_err(|error| RunError::Threads(error.to_string()))?;
        let own = own();
        Ok((other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), own))
    })
}

/// What a function returns for each number below `count`, in their order, computed in so many threads. After an
/// error no further numbers are begun.
///
/// # Errors
/// The first error in the order of the numbers that were begun.
pub fn each<T: Send>(
    threads: usize,
    count: usize,
    one: impl Fn(usize) -> Result<T, RunError> + Sync,
) -> Result<Vec<T>, RunError> {
    let next = AtomicUsize::new(0);
    let some = || {
        let mut done = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return done;
            }
            let result = one(number);
            if result.is_err() {
                next.store(count, Ordering::Relaxed);
            }
            done.push((number, result));
        }
    };
    let mut done = std::thread::scope(|scope| {
        // Where the system gives no further thread, those that there are do it.
        let start = |_| std::thread::Builder::new().spawn_scoped(scope, some).ok();
        let others: Vec<_> = (1..threads.min(count)).filter_map(start).collect();
        let mut done = some();
        for other in others {
            done.extend(other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        }
        done
    });
    done.sort_unstable_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_whatever_the_number_of_threads() {
        for jobs in [0, 1, 2, 9] {
            assert_eq!(each(jobs, 100, |number| Ok(2 * number)).unwrap(), (0..100).map(|n| 2 * n).collect::<Vec<_>>());
            assert_eq!(each(jobs, 0, Ok).unwrap(), Vec::<usize>::new());
        }
    }

    #[test]
    fn after_an_error_nothing_more_is_begun() {
        let begun = AtomicUsize::new(0);
        let failing = |number: usize| {
            begun.fetch_add(1, Ordering::Relaxed);
            if number < 3 { Ok(()) } else { Err(RunError::Threads(number.to_string())) }
        };
        assert!(matches!(each(1, 100, failing), Err(RunError::Threads(text)) if text == "3"));
        assert_eq!(begun.load(Ordering::Relaxed), 4);
        assert!(each(4, 100, failing).is_err());
    }
}
