from __future__ import annotations

from foreglow.display.progress import SceneProgress


def test_scenes_and_frames_are_counted_in_any_order() -> None:
    progress = SceneProgress(2, 5)
    for sequence, num_done, num_frames in ((1, 1, 2), (2, 1, 3), (1, 2, 2), (2, 2, 3)):
        progress(sequence, num_done, num_frames)
    assert (progress.num_finished, progress.num_done) == (1, 4)
    progress(2, 3, 3)
    progress.close()
    assert (progress.num_finished, progress.num_done) == (2, 5)
