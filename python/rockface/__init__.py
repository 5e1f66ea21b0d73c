"""rockface in Python: run pipelines, read what they made as arrays, and write steps as functions.

```python
import rockface

run = rockface.run("quickstart")        # a pipeline that ships with rockface, or a YAML file
run["event.change"].plot()           # a DEM difference with its grid
run.table("trial")                      # one row a point: axes and metrics
```
"""

from importlib import metadata as _metadata

from rockface._errors import (
    FormatError,
    PipelineError,
    ProgramError,
    RockfaceError,
    StepError,
    StepFailure,
    StoreError,
)
from rockface.artefacts import (
    Cameras,
    Cloud,
    Covariance,
    DepthMap,
    Figure,
    File,
    Files,
    Frame,
    Georeference,
    Grid,
    Image,
    Inventory,
    Mesh,
    Meshes,
    Pair,
    Pairs,
    Part,
    Picture,
    Raster,
    Record,
    Sensor,
    Surface,
    Table,
    Transform,
)
from rockface.files import read
from rockface.plans import Explanation, PlannedStep, explain, plan
from rockface.running import run
from rockface.runs import Outputs, Run, Step
from rockface.runs import find as open
from rockface.stages import Gathered, Random, Range, headline, metric, note, stage, warn

try:
    __version__ = _metadata.version("rockface")
except _metadata.PackageNotFoundError:
    # Imported from a clone without having been installed.
    __version__ = "0"

__all__ = [
    "Cameras",
    "Cloud",
    "Covariance",
    "DepthMap",
    "Explanation",
    "Figure",
    "File",
    "Files",
    "FormatError",
    "Frame",
    "Gathered",
    "Georeference",
    "Grid",
    "Image",
    "Inventory",
    "Mesh",
    "Meshes",
    "Outputs",
    "Pair",
    "Pairs",
    "Part",
    "Picture",
    "PipelineError",
    "PlannedStep",
    "ProgramError",
    "Random",
    "Range",
    "Raster",
    "Record",
    "RockfaceError",
    "Run",
    "Sensor",
    "Step",
    "StepError",
    "StepFailure",
    "StoreError",
    "Surface",
    "Table",
    "Transform",
    "__version__",
    "explain",
    "headline",
    "metric",
    "note",
    "open",
    "plan",
    "read",
    "run",
    "stage",
    "warn",
]
