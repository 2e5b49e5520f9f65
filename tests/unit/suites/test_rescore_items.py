"""How archived images are put together before they are scored again."""

from __future__ import annotations

import hashlib

from synthetic import estimator

from horizonval.store.entry import StoreEntry
from horizonval.store.store import Store
from horizonval.suites.identity import rescored_identity
from horizonval.suites.units.archived import Item, cases_of_heads, climates_of, items_of


def address(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def image(scene: str, *, head: str = "", band: str = "vis", seed: str = "0", epoch: str = "t") -> StoreEntry:
    name = f"{scene} {head} {band} {seed} {epoch}"
    return StoreEntry(
        address=address(name), kind="image", size_bytes=1, scene=scene, scene_id=f"id {scene} {head} {epoch}",
        camera="cam", bands=(band,), head=head, seed=seed, epoch_utc=epoch,
    )  # fmt: skip


def frame(scene: str, *, head: str = "", epoch: str = "t") -> StoreEntry:
    return StoreEntry(
        address=address(f"frame {scene} {head} {epoch}"), kind="frame", size_bytes=1, scene=scene,
        scene_id=f"id {scene} {head} {epoch}", camera="cam", bands=("vis",), head=head, epoch_utc=epoch,
    )  # fmt: skip


ALONE, HEADS = estimator("alone"), estimator("heads", needs="heads")


def test_bands_of_a_case_belong_together_and_have_its_frame():
    red, blue = image("noon", band="red"), image("noon", band="blue")
    (item,) = items_of([red, blue, frame("noon"), frame("night")], [ALONE])
    assert (item.name, item.together) == ("noon", False)
    assert item.images == {"": {"red": red.address, "blue": blue.address}}
    assert item.frames == {"": frame("noon").address}


def test_heads_have_names_of_their_own_and_a_common_one():
    left, right, other = image("s", head="left"), image("s", head="right"), image("one", head="left")
    items = items_of([left, right, other, frame("s", head="left")], [ALONE, HEADS])
    assert [(item.name, item.together, sorted(item.images)) for item in items] == [
        ("one", False, ["left"]),
        ("s", True, ["left", "right"]),
        ("s.left", False, ["left"]),
        ("s.right", False, ["right"]),
    ]
    assert [item.frames for item in items[1:]] == [
        {"left": frame("s", head="left").address, "right": ""},
        {"left": frame("s", head="left").address},
        {"right": ""},
    ]
    assert cases_of_heads(items) == {"s": [["left", "s.left"], ["right", "s.right"]]}
    assert [item.name for item in items_of([left, right], [HEADS])] == ["s"]
    assert cases_of_heads(items_of([left, right], [HEADS])) == {"s": []}


def test_draws_and_instants_of_one_scene_are_told_apart():
    many = [image("s"), image("s", seed="1"), image("s", epoch="later"), image("t")]
    items = items_of(many, [ALONE])
    assert sorted(item.name for item in items) == sorted([*(f"s.{one.address[:12]}" for one in many[:3]), "t"])
    # The same in another exposure: only the address differs.
    again = [many[3], StoreEntry(**(vars(many[3]) | {"address": address("longer")}))]
    assert len({item.name for item in items_of(again, [ALONE])}) == 2


def test_two_frames_that_could_be_meant_are_none():
    twice = [frame("noon"), StoreEntry(**(vars(frame("noon")) | {"address": address("other code")}))]
    assert items_of([image("noon"), *twice], [ALONE])[0].frames == {"": ""}


def test_the_air_that_a_prior_names_counts_by_its_content(tmp_path, make_image):
    table, store = tmp_path / "air.npz", Store(tmp_path / "archive")
    table.write_bytes(b"one air")
    addresses = {
        name: store.add_image(make_image(scene={"scene": {"name": name}, **prior}))
        for name, prior in {"knows": {"prior": {"climate": str(table)}}, "named": {"prior": {"climate": "us"}},
                            "none": {}}.items()
    }  # fmt: skip

    def identity(name: str) -> str:
        item = Item(name, {"": {"vis": addresses[name]}}, {})
        return rescored_identity(item.addresses, ["ideal"], climates_of(item, store))

    before = {name: identity(name) for name in addresses}
    table.write_bytes(b"another air")
    after = {name: identity(name) for name in addresses}
    assert before["knows"] != after["knows"]
    assert (before["named"], before["none"]) == (after["named"], after["none"])
    table.unlink()
    assert identity("knows") not in (before["knows"], after["knows"])


def test_a_damaged_image_names_no_air(tmp_path, make_image):
    store = Store(tmp_path)
    address = store.add_image(make_image())
    store.path(address).write_bytes(b"no image")
    assert climates_of(Item("a", {"": {"vis": address}}, {}), store) == set()
