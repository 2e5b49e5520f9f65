from horizonval.core.errors import nearest


def test_most_similar_first_and_none_lost() -> None:
    names = ["tropical", "us76", "us_standard"]
    assert nearest("us-standard", names)[0] == "us_standard"
    assert nearest("TROPIC", names)[0] == "tropical"
    assert sorted(nearest("", names)) == sorted(names)
