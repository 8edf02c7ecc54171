"""How far a study is, and why what is stored cannot be taken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from adaptmg.runtime.fingerprint import Fingerprint
from adaptmg.study.record import Record

__all__ = ["StudyStatus", "reasons"]

#: reasons that are told one by one
_MOST = 12


@dataclass(frozen=True, kw_only=True)
class StudyStatus:
    """Counts of the runs of a study.

    Attributes
    ----------
    name : str
    done, failed, stale, missing : int
        Stored and valid; stored, valid and failed; stored for another state of code, values or packages; not there.
    reasons : dict of str to int
        Why runs are stale, and how many for that reason; one run may have several.
    errors : dict of str to int
        Errors of failed runs, and how many have each.
    """

    name: str
    done: int
    failed: int
    stale: int
    missing: int
    reasons: dict[str, int] = field(default_factory=dict)
    errors: dict[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """Runs of the study."""
        return self.done + self.failed + self.stale + self.missing

    def __repr__(self) -> str:
        lines = [f"Study {self.name!r}: {self.total} runs: {self.done} done, {self.failed} failed, {self.stale} stale, "
                 f"{self.missing} missing"]
        for title, found in (("stale", self.reasons), ("failed", self.errors)):
            ordered = sorted(found.items(), key=lambda item: (-item[1], item[0]))
            lines += [f"  {title}: {text} ({count})" for text, count in ordered[:_MOST]]
            if len(ordered) > _MOST:
                lines.append(f"  {title}: {len(ordered) - _MOST} more")
        return "\n".join(lines)


def reasons(stale: Iterable[Record], now: Fingerprint, versions: Mapping[str, str],
            origins: Mapping[str, Mapping[str, str]]) -> dict[str, int]:
    """Why records are stale, with the number of records.

    Parameters
    ----------
    stale : iterable of Record
    now : Fingerprint
        What a run depends on now.
    versions : mapping
        Of packages, now.
    origins : mapping
        Parts of fingerprints by their code, from the store.
    """
    kinds: Counter[tuple[str, tuple[tuple[str, str], ...]]] = Counter(
        (record.code, tuple(record.versions.items())) for record in stale)
    found: Counter[str] = Counter()
    for (code, stored), count in kinds.items():
        then = dict(stored)
        told = [f"{name} {then.get(name, 'none')} -> {versions.get(name, 'none')}"
                for name in sorted({*then, *versions}) if then.get(name) != versions.get(name)]
        if code != now.code:
            told += now.differences(origins[code]) if code in origins else \
                ["stored by a version of adaptmg that did not say what a run depends on"]
        for text in told:
            found[text] += count
    return dict(found)
