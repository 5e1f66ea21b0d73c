//! The inputs of a stage: artefacts by port, each read from the store when the stage first asks for it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use crate::StageError;
use crate::artefact::{Artefact, Kind, Noun};
use crate::georeferencing::Stated;
use crate::stage::Point;

/// Loads an artefact that is not in memory yet.
type Read<'s> = dyn Fn() -> Result<Arc<Artefact>, StageError> + Send + Sync + 's;

/// An artefact that is read when a stage first asks for it.
pub struct Later<'s> {
    value: OnceLock<Arc<Artefact>>,
    /// A value that nobody else will ask for, until the stage does.
    last: Mutex<Option<Arc<Artefact>>>,
    read: Option<Box<Read<'s>>>,
}

impl std::fmt::Debug for Later<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Later").field("value", &self.value).finish_non_exhaustive()
    }
}

impl<'s> Later<'s> {
    /// A value in memory.
    pub fn ready(value: Arc<Artefact>) -> Self {
        Self { value: OnceLock::from(value), last: Mutex::default(), read: None }
    }

    /// A value in memory that nobody else will ask for: [`Inputs::owned`] hands it over without a copy.
    pub fn last(value: Arc<Artefact>) -> Self {
        Self { value: OnceLock::new(), last: Mutex::new(Some(value)), read: None }
    }

    /// A value that `read` loads.
    pub fn new(read: impl Fn() -> Result<Arc<Artefact>, StageError> + Send + Sync + 's) -> Self {
        Self { value: OnceLock::new(), last: Mutex::default(), read: Some(Box::new(read)) }
    }

    /// The value, if it was loaded and is still held; a value given to [`Later::ready`] does not count.
    pub fn kept(&self) -> Option<&Arc<Artefact>> {
        self.value.get().filter(|_| self.read.is_some())
    }

    fn read(&self) -> Result<Arc<Artefact>, StageError> {
        // In this order: another thread may move it from one place to the other meanwhile.
        let last = self.lock_last().clone();
        match (self.value.get().cloned().or(last), &self.read) {
            (Some(value), _) => Ok(value),
            (None, Some(read)) => read(),
            (None, None) => Err(StageError::new("an input was handed over before, or is neither there nor to be read")),
        }
    }

    /// The value to be changed: what nobody else will ask for goes without a copy, and is not there any more.
    fn take(&self) -> Result<Artefact, StageError> {
        let last = if self.value.get().is_none() { self.lock_last().take() } else { None };
        last.map_or_else(|| self.read(), Ok).map(Arc::unwrap_or_clone)
    }

    fn lock_last(&self) -> MutexGuard<'_, Option<Arc<Artefact>>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn keep(&self) -> Result<&Arc<Artefact>, StageError> {
        if let Some(value) = self.value.get() {
            return Ok(value);
        }
        let mut last = self.lock_last();
        if let Some(value) = last.take() {
            return Ok(self.value.get_or_init(|| value));
        }
        drop(last);
        let value = self.read()?;
        Ok(self.value.get_or_init(|| value))
    }
}

/// One element of an input: the point it was gathered from (empty for a plain reference), and its value.
#[derive(Debug, Clone)]
pub struct Element<'s> {
    /// Item of each gathered axis.
    pub point: Point,
    label: Arc<str>,
    value: Arc<Later<'s>>,
    stated: Arc<Stated>,
}

impl Element<'_> {
    /// The value, kept in memory until the stage is done.
    ///
    /// # Errors
    /// It cannot be read, or is in another coordinate reference system than an input that was read before.
    pub fn artefact(&self) -> Result<&Artefact, StageError> {
        self.shared().map(Arc::as_ref)
    }

    fn shared(&self) -> Result<&Arc<Artefact>, StageError> {
        let artefact = self.value.keep()?;
        self.stated.note(&self.label, artefact)?;
        Ok(artefact)
    }
}

/// The artefacts handed to a stage, by port.
///
/// An artefact is read when the stage first asks for it. Those asked for by reference stay in memory until the stage is done;
/// [`Inputs::visit`] holds one at a time, for stages that gather many large ones.
///
/// ```
/// use std::sync::Arc;
///
/// use rockface_core::artefact::{Picture, Table};
/// use rockface_core::{Inputs, Point};
///
/// let mut inputs = Inputs::default();
/// for trial in ["0", "1"] {
///     let point = Point::from([("trial".to_owned(), trial.to_owned())]);
///     inputs.push("tables", point, Arc::new(Table::new(["x"]).into()));
/// }
/// let gathered = inputs.many::<Table>("tables")?;
/// assert_eq!(gathered[1].0["trial"], "1");
/// assert_eq!(inputs.optional::<Picture>("picture")?, None);
/// assert_eq!(inputs.visit("tables", 0, |table: &Table| table.columns.len())?, 1);
///
/// let error = inputs.one::<Table>("tables").unwrap_err();
/// assert_eq!(error.message, "port `tables` needs one artefact, found 2");
/// # Ok::<(), rockface_core::StageError>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Inputs<'s> {
    ports: BTreeMap<String, Vec<Element<'s>>>,
    stated: Arc<Stated>,
}

impl<'s> Inputs<'s> {
    /// Adds an element that is there to a port.
    pub fn push(&mut self, port: &str, point: Point, artefact: Arc<Artefact>) {
        self.push_later(port, point, Arc::new(Later::ready(artefact)));
    }

    /// Adds an element that may have to be read to a port.
    pub fn push_later(&mut self, port: &str, point: Point, value: Arc<Later<'s>>) {
        let stated = self.stated.clone();
        let items: Vec<String> = point.iter().map(|(axis, item)| format!("{axis}={item}")).collect();
        let label = if items.is_empty() { port.to_owned() } else { format!("{port}[{}]", items.join(",")) };
        self.ports.entry(port.to_owned()).or_default().push(Element { point, label: label.into(), value, stated });
    }

    /// What the inputs that were read state about their place on the Earth.
    pub(crate) fn stated(&self) -> &Stated {
        &self.stated
    }

    /// All elements of a port.
    pub fn elements(&self, port: &str) -> &[Element<'s>] {
        self.ports.get(port).map_or(&[], Vec::as_slice)
    }

    /// The only artefact of a port, of whatever kind the port takes.
    pub fn artefact(&self, port: &str) -> Result<&Artefact, StageError> {
        self.shared(port).map(Arc::as_ref)
    }

    /// The same, as other steps may hold it too.
    ///
    /// # Errors
    /// As [`Inputs::artefact`].
    pub fn shared(&self, port: &str) -> Result<&Arc<Artefact>, StageError> {
        match self.elements(port) {
            [element] => element.shared(),
            found => Err(not_one(port, found.len())),
        }
    }

    /// The only artefact of a port, as the type the stage works on.
    pub fn one<T: Noun>(&self, port: &str) -> Result<&T, StageError> {
        typed(port, self.artefact(port)?)
    }

    /// The only artefact of a port for a stage that changes it: moved where no other step will ask for it and the port says that it is
    /// [`Port::changed`](crate::Port::changed), else a copy. It can be asked for once.
    pub fn owned<T: Noun + TryFrom<Artefact, Error = Kind>>(&self, port: &str) -> Result<T, StageError> {
        let [element] = self.elements(port) else { return Err(not_one(port, self.elements(port).len())) };
        let artefact = element.value.take()?;
        element.stated.note(&element.label, &artefact)?;
        T::try_from(artefact).map_err(|found| wrong_kind(port, T::KIND, found))
    }

    /// The artefact of an optional port.
    pub fn optional<T: Noun>(&self, port: &str) -> Result<Option<&T>, StageError> {
        if self.elements(port).is_empty() { Ok(None) } else { self.one(port).map(Some) }
    }

    /// Every artefact of a port, with the point it was gathered from.
    pub fn many<T: Noun>(&self, port: &str) -> Result<Vec<(&Point, &T)>, StageError> {
        self.elements(port).iter().map(|e| Ok((&e.point, typed(port, e.artefact()?)?))).collect()
    }

    /// One artefact of a port by its place in the list.
    pub fn nth<T: Noun>(&self, port: &str, index: usize) -> Result<&T, StageError> {
        typed(port, self.element(port, index)?.artefact()?)
    }

    /// Looks at one artefact of a port; an artefact read for this call is released after it.
    pub fn visit<T: Noun, R>(&self, port: &str, index: usize, look: impl FnOnce(&T) -> R) -> Result<R, StageError> {
        let element = self.element(port, index)?;
        let artefact = element.value.read()?;
        element.stated.note(&element.label, &artefact)?;
        typed(port, &artefact).map(look)
    }

    fn element(&self, port: &str, index: usize) -> Result<&Element<'s>, StageError> {
        let elements = self.elements(port);
        let missing = || StageError::new(format!("port `{port}` has {} elements, no number {index}", elements.len()));
        elements.get(index).ok_or_else(missing)
    }
}

fn typed<'a, T: Noun>(port: &str, artefact: &'a Artefact) -> Result<&'a T, StageError> {
    T::of(artefact).ok_or_else(|| wrong_kind(port, T::KIND, artefact.kind()))
}

fn wrong_kind(port: &str, needed: Kind, found: Kind) -> StageError {
    StageError::new(format!("port `{port}` needs a {needed}, found a {found}"))
}

fn not_one(port: &str, found: usize) -> StageError {
    StageError::new(format!("port `{port}` needs one artefact, found {found}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::{Picture, Table};
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn picture(n: u8) -> Arc<Artefact> {
        Arc::new(Picture { png: vec![n] }.into())
    }

    #[test]
    fn what_is_visited_is_let_go_and_what_is_asked_for_is_kept() {
        let reads = AtomicUsize::new(0);
        let later = Arc::new(Later::new(|| {
            reads.fetch_add(1, Ordering::Relaxed);
            Ok(picture(7))
        }));
        let mut inputs = Inputs::default();
        inputs.push_later("a", Point::new(), later.clone());
        inputs.push_later("b", Point::new(), later.clone());
        assert_eq!(reads.load(Ordering::Relaxed), 0);
        let visit = |port: &str| inputs.visit("a", 0, |p: &Picture| p.png[0]).map(|n| (n, port.len())).unwrap();
        assert_eq!((visit("a"), visit("b")), ((7, 1), (7, 1)));
        assert_eq!(reads.load(Ordering::Relaxed), 2);
        assert!(later.kept().is_none());
        assert_eq!(inputs.one::<Picture>("a").unwrap().png, [7]);
        assert_eq!(inputs.nth::<Picture>("b", 0).unwrap().png, [7]);
        visit("b");
        assert_eq!(reads.load(Ordering::Relaxed), 3);
        assert!(later.kept().is_some());
    }

    #[test]
    fn what_nobody_else_asks_for_is_handed_over_and_other_values_are_copied() {
        let address = |picture: &Picture| picture.png.as_ptr();
        let of = |artefact: &Arc<Artefact>| address(Picture::of(artefact).unwrap());
        let mut inputs = Inputs::default();
        let [last, looked_at, shared] = [1, 2, 3].map(picture);
        let addresses = [&last, &looked_at, &shared].map(of);
        inputs.push_later("last", Point::new(), Arc::new(Later::last(last)));
        inputs.push_later("looked_at", Point::new(), Arc::new(Later::last(looked_at)));
        inputs.push("shared", Point::new(), shared.clone());
        assert_eq!(inputs.visit("last", 0, address).unwrap(), addresses[0]);
        let owned = inputs.owned::<Picture>("last").unwrap();
        assert_eq!((address(&owned), &owned.png[..]), (addresses[0], &[1][..]));
        assert!(inputs.one::<Picture>("last").unwrap_err().message.contains("handed over before"));
        // A reference to it may be in use.
        let seen = inputs.one::<Picture>("looked_at").unwrap();
        let owned = inputs.owned::<Picture>("looked_at").unwrap();
        assert!(address(&owned) != addresses[1] && owned == *seen);
        assert!(address(&inputs.owned::<Picture>("shared").unwrap()) != addresses[2]);
        assert_eq!(inputs.one::<Picture>("shared").unwrap().png, [3]);
        assert!(inputs.owned::<Table>("shared").unwrap_err().message.contains("needs a table, found a picture"));
        assert!(inputs.owned::<Table>("none").unwrap_err().message.contains("needs one artefact, found 0"));
    }

    #[test]
    fn several_threads_may_ask_at_once_for_what_nobody_else_asks_for() {
        for _ in 0..200 {
            let mut inputs = Inputs::default();
            inputs.push_later("last", Point::new(), Arc::new(Later::last(picture(1))));
            std::thread::scope(|scope| {
                for _ in 0..4 {
                    scope.spawn(|| assert_eq!(inputs.one::<Picture>("last").unwrap().png, [1]));
                    scope.spawn(|| inputs.visit("last", 0, |seen: &Picture| assert_eq!(seen.png, [1])).unwrap());
                }
            });
        }
    }

    #[test]
    fn what_cannot_be_had_is_told_when_it_is_asked_for() {
        let mut inputs = Inputs::default();
        inputs.push_later("a", Point::new(), Arc::new(Later::new(|| Err(StageError::new("gone")))));
        inputs.push("a", Point::new(), picture(1));
        assert_eq!(inputs.many::<Picture>("a").unwrap_err().message, "gone");
        assert!(inputs.nth::<Picture>("a", 2).unwrap_err().message.contains("no number 2"));
        assert!(inputs.nth::<Table>("a", 1).unwrap_err().message.contains("needs a table, found a picture"));
        assert_eq!(inputs.visit("a", 1, |p: &Picture| p.png[0]).unwrap(), 1);
    }
}
