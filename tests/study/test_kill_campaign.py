"""A study that is killed with -9 and resumed has every run once, equal to the last bit to one that was not."""


import pytest

pytest.importorskip("psutil")


@pytest.mark.slow
def test_kills_of_main_process_worker_and_all():
    from killing import campaign

    assert campaign(runs=8, kills=2, seed=1) == {"done": 8, "different": 0, "left": []}
