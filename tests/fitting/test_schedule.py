"""When a level ends."""

from functools import reduce

import pytest

from napari_deltamic.fitting.objective.convergence import Remaining
from napari_deltamic.fitting.objective.schedule import Progress, Schedule

S = Schedule()
LITTLE, MUCH = Remaining(0.001, 0.001, 0), Remaining(1.0, 10.0, 0)


def after(values, variance=1.0, moved=True):
    first, *rest = values
    begun = Progress().posed(first, variance, S)
    return reduce(lambda progress, value: progress.stepped(value, moved, S), rest, begun)


def rests(progress, remaining):
    """Whether it rests when looked at as often as it takes."""
    for _ in range(S.rests):
        progress = progress.looked(remaining, 0.01, S)
    return progress.at_rest(S)


def test_a_coarse_level_ends_when_it_gains_little_or_takes_long():
    falling = [100 * 0.9**k for k in range(12)]
    assert not after(falling).coarse_ends(S)
    assert after([*falling, *6 * [falling[-1]]]).coarse_ends(S)
    assert not after([100.0, *3 * [99.9]]).coarse_ends(S)  # it has only begun
    assert after([0.9**k for k in range(S.coarse_most + 1)]).coarse_ends(S)


def test_a_level_that_finds_no_way_down_twice_ends():
    once = after([1.0, 1.0], moved=False)
    assert not once.coarse_ends(S)
    assert not rests(once, MUCH)
    twice = once.stepped(1.0, False, S)
    assert twice.coarse_ends(S)
    assert rests(twice, MUCH)
    assert once.stepped(1.0 - 2 * S.gain, True, S).stuck == 0


def test_ever_more_patches_may_move_after_a_while():
    assert S.may_move(S.patience - 1) == 0
    assert S.may_move(S.patience) == S.moving
    assert S.may_move(S.patience + S.doubled_every) == 2 * S.moving


def test_steps_that_gain_next_to_nothing_do_not_keep_a_fit_going():
    once = after([1.0, 1.0], moved=False)
    crept = once.stepped(1.0 - 0.5 * S.gain, True, S)
    assert crept.stuck == 1
    assert rests(crept.stepped(1.0, False, S), MUCH)


@pytest.mark.parametrize("remaining", [Remaining(0.001, 10.0, 0), Remaining(1.0, 0.001, 0)])
def test_the_last_level_rests_where_little_moves_or_is_gained(remaining):
    progress = after(7 * [1.0])
    assert rests(progress, remaining)
    assert not rests(progress, MUCH)


def test_a_large_surface_rests_though_a_few_patches_move():
    progress = after((S.patience + 1) * [1.0])
    few = Remaining(1.0, 10.0, 0, share=S.moving)
    assert rests(progress, few)
    assert not rests(after(S.patience * [1.0]), few)
    assert not rests(progress, Remaining(1.0, 10.0, 0, share=1.1 * S.moving))


def test_voxels_stay_once_renewing_them_explains_no_more():
    progress = Progress().posed(1.0, 4.0, S, left=2.0)
    assert not progress.held
    assert not progress.posed(1.0, 4.0, S, left=1.9).held
    assert not progress.posed(1.0, 2.0, S, left=2.0).held  # its variance is another one
    held = progress.posed(1.0, 4.0, S, left=1.99)
    assert held.held
    assert held.posed(1.0, 4.0, S, left=1.0).held
    assert not held.released().held


def test_one_look_is_not_rest():
    progress = after(7 * [1.0]).looked(LITTLE, 0.01, S)
    assert not progress.at_rest(S)
    assert not progress.looked(MUCH, 0.01, S).looked(LITTLE, 0.01, S).at_rest(S)


def test_nothing_rests_before_a_window_has_passed():
    assert not rests(after(S.window * [1.0]), LITTLE)
    assert rests(after((S.window + 1) * [1.0]), LITTLE)


def test_another_objective_begins_another_window_not_another_level():
    progress = after(7 * [1.0]).posed(5.0, 1.0, S)
    assert (progress.iterations, progress.since_posed, progress.values) == (6, 0, (5.0,))


def test_a_variance_has_settled_when_it_hardly_changes():
    progress = Progress().posed(1.0, 4.0, S)
    assert not progress.settled
    assert progress.posed(1.0, 4.2, S).settled
    assert not progress.posed(1.0, 2.0, S).settled


def test_what_shines_is_asked_again_once_the_surface_goes_elsewhere():
    progress = Progress(sure=True, answered=True)
    assert progress.posed(1.0, 4.0, S).stepped(0.9, True, S).answered
    assert progress.released().sure
    assert not progress.released().answered


def test_an_objective_that_fell_much_is_posed_anew_before_the_end():
    posed = after([100.0]).posed(100.0, 1.0, S)
    assert posed.final(S)
    assert posed.stepped(100.0 * (1 - 0.9 * S.fallen), True, S).final(S)
    assert not posed.stepped(100.0 * (1 - 1.1 * S.fallen), True, S).final(S)
    assert not after([100.0]).final(S)  # nothing to compare its variance with
