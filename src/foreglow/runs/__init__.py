"""The folder that a run leaves: each file has a module here, which writes it and reads it.

| file | module | contents |
|---|---|---|
| `frames.jsonl` | `frames_file` | the results of each frame, a `FrameLine` each |
| `times.jsonl` | `times_file` | the run-times of the stages for each frame, a `TimesLine` each |
| `summary.json` | `summary` | a `SummaryFile`: counts, run-times, version and machine; counted by `tally` |
| `config.toml` | `foreglow.config` | the configuration |

`folder` makes all of them appear together, and `recorded_run` reads them all. `predictions` reads boxes for evaluation,
from a `frames.jsonl` or from the JSON of the published code, and writes the latter.
"""
