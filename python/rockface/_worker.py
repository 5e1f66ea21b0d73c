"""The process in which the functions of one module run: jobs come as lines of JSON and are answered by lines of JSON.

It is started by `rockface` with the path of the module. What a function prints goes to files of its job; its memory is
limited; whatever a function does, the answer is about that function, or the process ends and the program says how.
"""

from __future__ import annotations

import faulthandler
import gc
import importlib.util
import json
import os
import resource
import select
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from importlib.machinery import FileFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

from rockface import stages
from rockface._exchange import WrongOutputError, read, write
from rockface.files import mapped

GIB = 1 << 30
FRAMES = 12
"""Lines of a traceback that are reported."""
BASELINE_BYTES = 256 << 20
"""Memory a function may take besides what it declares: what its imports and the exchange need."""


class FunctionError(Exception):
    """Why a job failed, with the way out."""

    def __init__(self, message: str, hint: str | None = None, lines: list[str] | None = None, retire: bool = False) -> None:
        super().__init__(message)
        self.message, self.hint, self.lines, self.retire = message, hint, lines or [], retire


class FreshLoader(SourceFileLoader):
    """Imports from the text of a file, never from what was compiled of it before."""

    def get_code(self, fullname: str) -> Any:
        """The code of a module."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


class Worker:
    """The functions of one module."""

    def __init__(self, module: Path) -> None:
        self.path, self.pid = module, os.getpid()
        self.module: ModuleType | None = None
        # Answers go where standard output went; what functions print must not.
        self.answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
        # Jobs come where standard input came from; a function that asks for input finds its end.
        self.jobs = os.fdopen(os.dup(0), "r", encoding="utf-8")
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        self.said: tuple[int, int] | None = None
        folder = str(module.parent)
        sys.path_hooks.insert(0, self._hook(folder))
        sys.path[0] = folder
        self.threads = set(threading.enumerate())
        # Modules that were looked at: what is imported stays.
        self.seen: set[str] = set()

    @staticmethod
    def _hook(folder: str) -> Callable[[str], Any]:
        fresh = FileFinder.path_hook((FreshLoader, [".py"]))

        def hook(path: str) -> Any:
            if path != folder and not path.startswith(folder + os.sep):
                raise ImportError(path)
            return fresh(path)

        return hook

    def serve(self) -> None:
        """Works until there are no more jobs."""
        for line in self.jobs:
            job = json.loads(line)
            answer = self.answer(job)
            if os.getpid() != self.pid:
                # A child that the function forked and that came back here.
                os._exit(0)
            self.answers.write(json.dumps(answer) + "\n")
            self.answers.flush()
            if answer.get("retire"):
                return

    def answer(self, job: dict[str, Any]) -> dict[str, Any]:
        """The answer to one job."""
        stages._entries = []
        self.listen(job["folder"])
        try:
            self.work(job)
        except FunctionError as failure:
            error = {"message": failure.message, "hint": failure.hint, "traceback": failure.lines}
            return {"error": error, "log": stages._entries, "retire": failure.retire}
        finally:
            self.flush()
        return {"log": stages._entries}

    def listen(self, folder: str) -> None:
        """Directs what is printed from now on to files of the job."""
        for number, name in ((1, "stdout"), (2, "stderr")):
            file = os.open(os.path.join(folder, name), os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
            os.dup2(file, number)
            os.close(file)
        faulthandler.enable(2)

    def flush(self) -> None:
        """Writes what is still to be printed."""
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except (OSError, ValueError):
                # Closed by the function, or the disk is full: nothing of the result is lost by that.
                continue

    def work(self, job: dict[str, Any]) -> None:
        """Calls the function and writes its outputs."""
        request, paths, folder = job["request"], job["paths"], Path(job["folder"])
        function = self.function(request["function"], request["sources"], paths)
        arguments = self.arguments(request, paths, folder)
        declared: stages.Declared = getattr(function, stages.ATTRIBUTE)
        before = self.limit(declared.memory_gib)
        try:
            result = self.call(function, arguments, declared)
            for name, data in self.outputs(request["outputs"], result).items():
                (folder / name).write_bytes(data)
        except MemoryError as error:
            raise self.out_of_memory(declared) from error
        finally:
            resource.setrlimit(resource.RLIMIT_DATA, before)
        del result, arguments
        gc.collect(0)
        self.check_leftovers()
        self.check_imports(request["sources"], paths)

    def function(self, name: str, sources: Sequence[str], paths: dict[str, str]) -> Callable[..., Any]:
        """The function, from the module, which is imported once."""
        for dotted in sources:
            # Sources that lie elsewhere are found where planning has found them.
            path = Path(paths[f"source {dotted}"])
            depth = dotted.count(".") + (path.name == "__init__.py")
            root = str(path.parents[depth])
            if root not in sys.path:
                sys.path.append(root)
        try:
            if self.module is None:
                self.module = imported(self.path)
            function = getattr(self.module, name)
        except BaseException as error:
            told = f"importing `{self.path.name}` raised {said(error)}"
            raise FunctionError(told, None, told_frames(error, self.path), retire=True) from error
        if not callable(function) or not hasattr(function, stages.ATTRIBUTE):
            raise FunctionError(f"`{name}` is no stage once `{self.path.name}` is imported: `@rockface.stage` has to come first")
        return function  # type: ignore[no-any-return]

    def arguments(self, request: dict[str, Any], paths: dict[str, str], folder: Path) -> dict[str, Any]:
        """What the function is called with."""
        arguments = {name: typed(value, request["types"][name]) for name, value in request["params"].items()}
        for name, path in paths.items():
            if name.startswith("file "):
                arguments[name.removeprefix("file ")] = Path(path)
        for given in request["inputs"]:
            values = [read(given["kind"], mapped(folder / element["place"])) for element in given["elements"]]
            if given["many"]:
                arguments[given["port"]] = stages.Gathered(values, [element["point"] for element in given["elements"]])
            elif values:
                arguments[given["port"]] = values[0]
            else:
                arguments[given["port"]] = None
        if request["stream"] is not None:
            own = [name for name, kind in (self.hints(request["function"])).items() if str(kind).split(".")[-1] == "Random"]
            arguments.update(dict.fromkeys(own, stages.Random(bytes.fromhex(request["stream"]))))
        return arguments

    def hints(self, function: str) -> dict[str, Any]:
        """The annotations of a function, by parameter: classes, or texts as they are written."""
        annotations: dict[str, Any] = getattr(getattr(self.module, function), "__annotations__", {})
        return {name: getattr(kind, "__name__", kind) for name, kind in annotations.items() if name != "return"}

    def call(self, function: Callable[..., Any], arguments: dict[str, Any], declared: stages.Declared) -> Any:
        """The result of the function, or why it failed."""
        try:
            result = function(**arguments)
        except MemoryError as error:
            failure = self.out_of_memory(declared)
            failure.lines = told_frames(error, self.path)
            raise failure from error
        except SystemExit as error:
            raise FunctionError(
                f"it called sys.exit({error.code!r}); a stage returns or raises", None, told_frames(error, self.path)
            ) from error
        except BaseException as error:
            raise FunctionError(said(error), None, told_frames(error, self.path)) from error
        if os.getpid() != self.pid:
            os._exit(0)
        return result

    def out_of_memory(self, declared: stages.Declared) -> FunctionError:
        """The function wanted more memory than it may have."""
        told = f"it needs more than the {declared.memory_gib:g} GiB of memory it may take"
        return FunctionError(told, "allow it more with `@rockface.stage(memory_gib=...)`, or work in parts", retire=True)

    def limit(self, memory_gib: float) -> tuple[int, int]:
        """Limits the memory of this process from now on; returns the limit there was."""
        before = resource.getrlimit(resource.RLIMIT_DATA)
        pages = int(Path("/proc/self/statm").read_text().split()[5])
        most = pages * resource.getpagesize() + int(memory_gib * GIB) + BASELINE_BYTES
        hard = before[1]
        resource.setrlimit(resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
        return before

    def outputs(self, wanted: list[dict[str, str]], result: Any) -> dict[str, bytes]:
        """The files of the outputs, by place."""
        values = {wanted[0]["port"]: result} if len(wanted) == 1 and not hasattr(result, "_asdict") else None
        if values is None:
            if not hasattr(result, "_asdict"):
                names = ", ".join(port["port"] for port in wanted)
                raise FunctionError(f"it returned {type(result).__name__}, not a NamedTuple with {names}")
            values = result._asdict()
        files = {}
        for port in wanted:
            try:
                files[port["place"]] = write(port["kind"], values.get(port["port"]))
            except WrongOutputError as error:
                raise FunctionError(f"output `{port['port']}`: {error}") from error
            except (TypeError, ValueError, AttributeError, IndexError) as error:
                raise FunctionError(f"output `{port['port']}` is no {port['kind']}: {type(error).__name__}: {error}") from error
        return files

    def check_leftovers(self) -> None:
        """Refuses threads and processes that the function has left running: they would work on in the next step."""
        own = [t for t in threading.enumerate() if t not in self.threads and t.is_alive() and not t.daemon]
        if own:
            names = ", ".join(thread.name for thread in own)
            raise FunctionError(f"it left {len(own)} threads running: {names}", "join them before it returns", retire=True)
        running = children()
        if running:
            told = f"it left {len(running)} processes running"
            hint = "wait for what it started or forked: `with ProcessPoolExecutor() as pool`, `process.join()`, `os.waitpid(...)`"
            raise FunctionError(told, hint, retire=True)

    def check_imports(self, sources: Sequence[str], paths: dict[str, str]) -> None:
        """Refuses modules of the user's own that planning did not see: an edit of them would go unnoticed."""
        new = sys.modules.keys() - self.seen
        if not new:
            return
        known = {os.path.realpath(paths[f"source {name}"]) for name in sources} | {os.path.realpath(self.path)}
        self.seen |= new
        for name in sorted(new):
            file = getattr(sys.modules[name], "__file__", None)
            if not isinstance(file, str) or not file.endswith(".py") or is_installed(file) or os.path.realpath(file) in known:
                continue
            self.seen.discard(name)
            hint = "import it by an `import` statement in the module, so that its content is part of what the result is known by"
            raise FunctionError(f"it imported `{name}` ({file}) in a way that planning does not see", hint, retire=True)


def typed(value: Any, kind: dict[str, Any]) -> Any:
    """A value of JSON in the Python type that the function declares."""
    if value is None:
        return None
    if kind["type"] == "list":
        return [typed(item, kind["of"]) for item in value]
    return {"number": float, "integer": int}.get(kind["type"], lambda value: value)(value)


def imported(path: Path) -> ModuleType:
    """The module of a file, under its own name."""
    spec = importlib.util.spec_from_file_location(path.stem, path, loader=FreshLoader(path.stem, str(path)))
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def is_installed(file: str) -> bool:
    """Whether a file belongs to Python, to this package or to an installed one."""
    parts = os.path.normpath(file).split(os.sep)
    own = os.path.dirname(os.path.realpath(__file__)) + os.sep
    standard = os.path.dirname(os.__file__) + os.sep
    return (
        bool({"site-packages", "dist-packages"} & set(parts)) or os.path.realpath(file).startswith(own) or file.startswith(standard)
    )


def children() -> list[int]:
    """Children of this process that still run, except the helper that Python keeps for shared memory."""
    while True:
        try:
            pid, _ = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return []
        if pid == 0:
            break
    tracker = sys.modules.get("multiprocessing.resource_tracker")
    helper = getattr(getattr(tracker, "_resource_tracker", None), "_pid", None)
    listed = [int(pid) for task in Path("/proc/self/task").iterdir() for pid in (task / "children").read_text().split()]
    return [pid for pid in listed if pid != helper]


def said(error: BaseException) -> str:
    """The type of an exception and what it says, if it can."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception as fault:
        return f"{type(error).__name__}, whose text raised {type(fault).__name__}"


def told_frames(error: BaseException, module: Path) -> list[str]:
    """The traceback from the module on, without the frames of this worker."""
    frames = traceback.extract_tb(error.__traceback__)
    inner = [frame for frame in frames if os.path.realpath(frame.filename) != os.path.realpath(__file__)]
    inner = [frame for frame in inner if "importlib" not in frame.filename]
    lines = [f"{Path(frame.filename).name}, line {frame.lineno}, in {frame.name}: {frame.line}" for frame in inner[-FRAMES:]]
    if isinstance(error, SyntaxError) and error.filename:
        lines.append(f"{Path(error.filename).name}, line {error.lineno}: {(error.text or '').strip()}")
    return lines


def watch(jobs: int, group: int) -> None:
    """Ends this process and its children when `rockface` is gone: nobody would read the answer."""
    poller = select.poll()
    poller.register(jobs, 0)
    while not any(happened & (select.POLLHUP | select.POLLERR) for _, happened in poller.poll()):
        continue
    os.killpg(group, signal.SIGKILL)


def main() -> None:
    """Serves the module that the command line names."""
    # Ctrl-C is for rockface, which ends this process if it has to.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    worker = Worker(Path(sys.argv[1]))
    watching = threading.Thread(target=watch, args=(worker.jobs.fileno(), os.getpgid(0)), daemon=True, name="rockface")
    watching.start()
    worker.threads.add(watching)
    worker.serve()


if __name__ == "__main__":
    main()
