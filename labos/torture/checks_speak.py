"""Bronze: the driver describes itself, does what it describes, and refuses what it cannot do."""

from __future__ import annotations

import time
from typing import Any

import msgspec

from labos.core.effects import AnyEffect, Carrying, Consumes, Needs, Requires, Sets
from labos.core.model import ActionSpec, Arg
from labos.node.protocol import Outcome, StateReport
from labos.node.torture import Case
from labos.torture.bench import describe_deeds, find_name, is_unresolved
from labos.torture.cases import find_unknown_cases, list_wrong_args, moves_labware
from labos.torture.session import END_S, TRIES, Attempt, Failed, LeftOut, Session, key_of


async def check_about(on: Session) -> None:
    """about is complete: everything has a description and limits, and each name is used once."""
    flaws = [*_find_ambiguous_names(on), *_find_undescribed(on), *_find_undeclared(on)]
    if flaws:
        raise Failed("; ".join(flaws))
    report = await on.kernel.about()
    if report.simulated == on.is_wired:
        raise Failed(f"about reports simulated = {report.simulated}")


def _find_ambiguous_names(on: Session) -> list[str]:
    """Names that are unknown, ambiguous or missing."""
    about = on.about
    flaws = [
        f"TORTURE has a case for {name}, which is not an action"
        for name in find_unknown_cases(about, on.torture)
    ]
    for kind, names in (
        ("action", [name for spec in about.actions for name in (spec.name, *spec.aliases)]),
        ("station", [name for station in about.stations for name in (station.name, *station.aliases)]),
    ):
        flaws += [f"two {kind}s are called {name}" for name in {n for n in names if names.count(n) > 1}]
    if not about.driver or not about.description:
        flaws.append("it has no name or no description")
    return flaws


def _find_undescribed(on: Session) -> list[str]:
    flaws = []
    for spec in on.about.actions:
        if not spec.description or spec.duration_s <= 0:
            flaws.append(f"{spec.name} has no description or no duration")
        if not spec.exclusive and any(isinstance(e, Carrying | Consumes | Needs) for e in spec.effects):
            flaws.append(f"{spec.name} may run beside other work, but moves or uses something")
        flaws += [
            f"{spec.name}: argument {arg.name} {flaw}"
            for arg in spec.args
            if (flaw := _find_argument_flaw(arg))
        ]
    return flaws


def _find_argument_flaw(arg: Arg) -> str:
    if arg.type == "any":
        return "has no type"
    if arg.type in ("int", "float") and not arg.unit:
        return "has no unit"
    if arg.type in ("str", "list", "dict", "bool") and not (arg.choices or arg.description):
        return "is not described"
    if arg.required or arg.default is None:
        return ""
    low, high = arg.minimum, arg.maximum
    outside = (low is not None and arg.default < low) or (high is not None and arg.default > high)
    return "has a default that it would refuse" if outside else ""


def _find_undeclared(on: Session) -> list[str]:
    """Effects that name stations, variables and resources that the driver does not have."""
    about = on.about
    stations = {name for station in about.stations for name in (station.name, *station.aliases)}
    flaws = []
    for case in on.cases:
        for effect in on.bench.effects(case, on.spec(case)):
            if is_unresolved(effect):
                flaws.append(f"{case.action}: {type(effect).__name__} is not filled in by its arguments")
            wanted = effect.variable if isinstance(effect, Requires | Sets) and effect.of == "module" else ""
            if wanted and wanted not in about.variables:
                flaws.append(f"{case.action}: it has no variable {wanted}")
            if isinstance(effect, Consumes) and effect.resource not in {**about.levels, **about.units}:
                flaws.append(f"{case.action}: it has no resource {effect.resource}")
            if isinstance(effect, Carrying) and not (about.manipulator and "gripper" in stations):
                flaws.append(f"{case.action} moves labware, but the driver is no manipulator with a gripper")
    flaws += [
        f"the station {station.name} depends on {name}, which is not a variable"
        for station in about.stations
        for name in station.access
        if name not in about.variables
    ]
    return list(dict.fromkeys(flaws))


async def check_happy_path(on: Session) -> None:
    """Each action has exactly its declared effects, once, and the module is then idle again."""
    for case in on.cases:
        spec = on.spec(case)
        await on.prepare(case)
        effects = on.bench.effects(case, spec)
        plates = [(effect, on.bench.find_subject(effect)) for effect in effects]
        used = {
            name: on.bench.world.find_level("device", name) for name in {**on.about.levels, **on.about.units}
        }
        began = time.monotonic()
        done = await on.ask_for(case)
        outcome = await on.learn(done)
        on.took_s[case.action] = time.monotonic() - began
        if case.refused:
            _check_declined(case.action, case.refused, outcome)
            continue
        if not outcome.succeeded:
            raise Failed(f"{case.action} fails: {outcome.error}")
        deeds = on.list_deeds(done)
        if spec.exclusive:
            await on.await_rest()
            if (later := on.list_deeds(done)) != deeds:
                raise Failed(
                    f"{case.action} reports its end, but its device continues: "
                    f"{describe_deeds(later - deeds)}"
                )
        on.reference[key_of(case)] = deeds
        if moves_labware(spec) and not deeds:
            raise Failed(f"{case.action} reports that it has moved something, but nothing moved on the bench")
        for effect, plate in plates:
            if wrong := on.bench.find_misplaced(case, effect, plate):
                raise Failed(f"{case.action}: {wrong}; it did {describe_deeds(deeds)}")
        _check_consumed(on, spec, effects, used)
        await _check_variables(on, case.action, effects)
        await on.await_idle()


def _check_declined(name: str, why: str, outcome: Outcome) -> None:
    if outcome.succeeded or outcome.effects != "none" or why not in outcome.error:
        raise Failed(f"{name} should fail with {why!r}; it reports {outcome.error or 'success'}")


def _check_consumed(
    on: Session, spec: ActionSpec, effects: tuple[AnyEffect, ...], before: dict[str, float | None]
) -> None:
    """Check that resources are used up as the effects declare, and no others. An amount from a file is not
    checked. Raises Failed."""
    spends = [effect for effect in effects if isinstance(effect, Consumes)]
    if sum(isinstance(effect, Consumes) for effect in spec.effects) > len(spends):
        return
    for resource, had in before.items():
        amounts = [effect.amount for effect in spends if effect.resource == resource]
        uses = [float(amount) for amount in amounts if isinstance(amount, int | float)]
        left = on.bench.world.find_level("device", resource)
        if had is None or left is None or len(uses) < len(amounts) or abs(had - left - sum(uses)) < 1e-6:
            continue
        raise Failed(f"{spec.name} declares that it uses {sum(uses):g} {resource}; it used {had - left:g}")


async def check_set_points(on: Session) -> str:
    """The device's own record has the requested speeds, times, temperatures and volumes."""
    tried = [case for case in on.cases if case.record is not None and not case.refused]
    for case in tried:
        for args in (case.args, _vary_set_points(on, case)):
            varied = msgspec.structs.replace(case, args=args)
            done = await on.begin(varied)
            outcome = await on.end(done)
            if not outcome.succeeded:
                raise Failed(f"{case.action} {args} fails: {outcome.error}")
            _check_recorded(on, done)
            await on.await_idle()
    numbers = sorted({f"{case.action} {name}" for case in on.cases for name in _list_set_points(on, case)})
    unseen = [name for name in numbers if name.partition(" ")[0] not in {case.action for case in tried}]
    return f"not seen in a record: {', '.join(unseen)}" if unseen else ""


def _list_set_points(on: Session, case: Case) -> list[str]:
    """The arguments of a case that are free numbers with a unit."""
    units = {
        arg.name
        for arg in on.spec(case).args
        if arg.type in ("int", "float") and arg.unit and not arg.choices
    }
    return [name for name in case.args if find_name(on.spec(case), name) in units]


def _vary_set_points(on: Session, case: Case) -> dict[str, Any]:
    """The arguments of a case with other numbers, each a tenth or more away and within its limits."""
    args = dict(case.args)
    by_name = {arg.name: arg for arg in on.spec(case).args}
    for place, name in enumerate(_list_set_points(on, case)):
        arg, value = by_name[find_name(on.spec(case), name)], args[name]
        for share in (0.8 - 0.1 * place, 1.2 + 0.1 * place):
            other = round(value * share) if arg.type == "int" else value * share
            low, high = arg.minimum, arg.maximum
            if other != value and (low is None or other >= low) and (high is None or other <= high):
                args[name] = other
                break
    return args


def _check_recorded(on: Session, done: Attempt) -> None:
    """Raises Failed."""
    assert done.case.record is not None
    wanted = done.case.record(done.case.args)
    noted = [motion.facts for motion in on.bench.motions(done.since)]
    for fact, value in wanted.items():
        found = [facts[fact] for facts in noted if fact in facts]
        if not found or not all(_is_close(value, other) for other in found):
            noted_ = ", ".join(map(str, found)) or "nothing"
            asked = f"{done.case.action} {done.case.args}"
            raise Failed(f"{asked}: the device's record should have {fact} = {value}; it has {noted_}")


def _is_close(wanted: Any, found: Any) -> bool:
    if isinstance(wanted, int | float) and isinstance(found, int | float):
        return abs(wanted - found) <= max(0.005 * abs(wanted), 1e-9)
    return bool(wanted == found)


async def _check_variables(on: Session, name: str, effects: tuple[Any, ...]) -> None:
    reply = await on.kernel.admin("observe")
    if not reply.done:
        raise Failed(f"after {name}, observe fails: {reply.why}")
    seen = reply.result if isinstance(reply.result, dict) else {}
    for effect in effects:
        if not isinstance(effect, Sets) or effect.of != "module" or effect.variable not in seen:
            continue
        if seen[effect.variable] != effect.value:
            raise Failed(
                f"after {name}, {effect.variable} should be {effect.value!r}; observe reports "
                f"{seen[effect.variable]!r}"
            )


async def check_invalid_arguments(on: Session) -> None:
    """Wrong arguments and unknown actions are refused permanently, and nothing moves."""
    since = on.bench.mark()
    calls = [(case.action, *wrong) for case in on.cases for wrong in list_wrong_args(case, on.spec(case))]
    for name, what, args in [*calls, ("no_such_action", "an unknown action", {})]:
        reply = await on.kernel.send(on.kernel.request(name, args))
        if reply.status != "refused":
            outcome = reply.outcome or await on.kernel.outcome(on.kernel.request(name, args), END_S)
            raise Failed(f"{name} accepts {what}: {outcome.error if outcome else reply.status}")
        if reply.transient or not reply.why:
            raise Failed(f"{name} refuses {what} only for the time being: {reply.why or 'without a reason'}")
    if deeds := on.bench.list_deeds(since, gates=False):
        raise Failed(f"it did {describe_deeds(deeds)} after a request with wrong arguments")


async def check_duplicate_id(on: Session) -> None:
    """An attempt that is requested again, while it runs and afterwards, is carried out only once."""
    case = on.choose_motion()
    done = await on.begin_to_middle(case, 0.2)
    again = await on.kernel.send(done.start)
    if again.status not in ("running", "accepted", "finished"):
        raise Failed(f"requested again while it runs, it answers {again.status}: {again.why}")
    outcome = await on.end(done)
    late = await on.kernel.send(done.start)
    if (late.status, late.outcome) != ("finished", outcome):
        raise Failed(f"requested again after its end, it answers {late.status}, and not as before")
    await on.await_rest()
    await on.judge(done, outcome)
    if not outcome.succeeded:
        raise Failed(f"{case.action} fails when it is requested twice: {outcome.error}")


async def check_busy(on: Session) -> None:
    """While it works, it reports BUSY, refuses other work for the time being, and answers queries."""
    case = on.choose_motion()
    done, state, other = await _ask_while_it_works(on, case)
    if other.reply.status != "refused" or not other.reply.transient:
        raise Failed(f"when {case.action} is requested while it works, it answers {other.reply.status}")
    if state.status != "BUSY" or done.start.action not in state.running:
        raise Failed(f"while it works, its state is {state.status}, running {state.running}")
    for query in (c for c in on.cases if not on.spec(c).exclusive and not c.refused):
        asked = await on.ask_for(query)
        if asked.reply.status == "refused":
            raise Failed(f"{query.action} is a pure query, but is refused while it works: {asked.reply.why}")
        # Changes in this time are caused by the motion.
        answer = await on.await_outcome(asked)
        if answer is None or not answer.succeeded:
            why = answer.error if answer is not None else "it has no answer"
            raise Failed(f"{query.action} is a pure query, but fails while it works: {why}")
    outcome = await on.end(done)
    if not outcome.succeeded:
        raise Failed(f"{case.action} fails because something else was requested: {outcome.error}")
    if (await on.kernel.ask(other.start)).status != "void":
        raise Failed("a refused action may still run later")


async def _ask_while_it_works(on: Session, case: Case) -> tuple[Attempt, StateReport, Attempt]:
    """Start a motion, ask for the node's state, and request another motion, all while the first is certainly
    under way. Raises Failed."""
    for _ in range(TRIES):
        done = await on.begin_to_middle(case, 0.2)
        state, other = await on.kernel.state(), await on.ask_for(case)
        if await on.is_running(done):
            return done, state, other
        await on.end(done)
        if other.reply.status != "refused":
            await on.kernel.outcome(other.start, END_S)
            await on.recover()
    raise Failed(f"{case.action} has ended before anything else can be requested: declare a longer `motion`")


def require_wire(on: Session) -> None:
    """Raises LeftOut."""
    if not on.is_wired:
        raise LeftOut("no wire: the driver drives only a device inside the node, so nothing can be unplugged")
