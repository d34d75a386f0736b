"""Command lines that make no sense or would overwrite what they read, and plug-ins with faults."""

OVERWRITING = """\
run @night.mp4 --out @night.mp4
run @images --out @images
run @night.mp4 --out out --record @night.mp4
run @night.mp4 --out out --config @results/config.toml --record @results/config.toml
run @night.mp4 --out out --model @model.onnx --save @model.onnx
run @night.mp4 --out @camera.toml --calibration @camera.toml
run @night.mcap --out out --record @night.mcap
record @night.mcap --out @night.mcap
record @images --out @images/000001.png
live @night.mcap --speed 0 --record @night.mcap
live @night.mcap --speed 0 --out @night.mcap
beam @results --out @results
beam @results --out @results/frames.jsonl
beam @results --out out --lamps @lamps.toml --save @lamps.toml
report @results --out @results/frames.jsonl
report @results --out @results/summary.json
evaluate @night/val --predictions @predictions.jsonl --json @predictions.jsonl
evaluate @night/val --predictions @predictions.jsonl --out @night/val
evaluate @night/val --predictions @predictions.jsonl --json @night/val/labels/sequences.json
export-mot @of_split @night/val --out @night/val
calibrate check @camera.toml @night.png --out @night.png
calibrate check @camera.toml @night.png --out @camera.toml
calibrate convert @camera.toml --out @camera.toml --mount-forward 1 --mount-height 1
simulate --scene @lamps.toml --out @lamps.toml
annotate @night/val --out @night/val/labels/sequences.json
calibrate auto @images --fov 50 --out @images/000001.toml
run @images --out out --save out/frames.jsonl
live @images --speed 0 --out out --save out/summary.json
evaluate @night/val --predictions @predictions.jsonl --out out --json out/results.json
evaluate @night/val --predictions @of_split/frames.jsonl --json @of_split/summary.json
evaluate @night/val --predictions @of_split/frames.jsonl --json @of_split/config.toml
calibrate convert @camera.toml --out @results/config.toml --mount-forward 1 --mount-height 1
calibrate convert @camera.toml --out @night.mp4 --mount-forward 1 --mount-height 1
report @results --out @night.mp4
beam @results --out out --save @night.mp4
evaluate @night/val --predictions @predictions.jsonl --json @night.png"""
"""Command lines of which an output is an input, holds one or lies in one."""

OWN_TRACKER = "class Own:\n    def __init__(self, *_): {}\n    def reset(self): {}\n    def update(self, *_): {}\n"

PLUG_INS = (
    "class",
    "import nothing",
    "raise SystemExit(0)",
    "Own = 3",
    "class Own: pass",
    "class Own:\n    def __init__(self, *_): pass",
    OWN_TRACKER.format("1 / 0", "pass", "pass"),
    OWN_TRACKER.format("pass", "raise OSError(28, 'No space')", "pass"),
    *(
        OWN_TRACKER.format("pass", "pass", end)
        for end in (
            "1 / 0",
            "raise SystemExit(0)",
            "raise GeneratorExit",
            "raise MemoryError",
            "return 5",
            "return self.update()",
        )
    ),
)
"""Trackers of one's own, each with a fault."""

MISUSE = """\
run
nothing
run @night.png --out
run --nothing
run @night.png @night.jpg --out out
beam @night.png
live
live camera:99 --give-up 0.5
live rtsp://127.0.0.1:1/x --give-up 0.5
live camera:x
live simulate:nothing
live 'gstreamer:nothing at all' --give-up 1
evaluate @images --preset paper
report @images
report @night.png
export-mot @images @night/val --out out
ON_VIDEO --preset nobody
ON_VIDEO --map @town.geojson
ON_VIDEO --poses @drive.csv
ON_VIDEO --dbc @street.dbc
ON_VIDEO --topic /none
ON_VIDEO --cluster tcp://127.0.0.1:1
run @night.mcap --topic /none --out out
beam @results --out out --policy none:Such
beam @results --out out --policy os:system
beam @results --out out --policy json:tool
live @images --speed 0 --can nothing:x
live @images --speed 0 --can :::
live @images --speed 0 --rate 5
live @images --speed 0 --time-offset 3
live camera:0 --speed 2
live simulate:curve --calibration @camera.toml
beam @results --out out --on-error mark
run @night.png --out out --limit 1.5
run / --out out
run /dev/null --out out
run /proc/self --out out
record @night.png --out out.txt
simulate
simulate --preview nothing --out out
simulate --scene @lamps.toml --out out
simulate --out out --size 0x0
simulate --out out --size 1e9x1
train @images --out out
train @night --out out
tune @images --out out
annotate @images
experiment nothing
experiment detector @images --out out
experiment glare @night --out out
calibrate check @night.png @camera.toml --out out.png
download nothing
import-weights @night.png --out out.onnx
fit-ranges @images --out out"""
"""Command lines that make no sense."""
