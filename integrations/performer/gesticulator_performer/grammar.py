"""Sentences of the corpus: topics with their words, and templates by meaning.

A template's slots: {thing} {other} {things} {athing} {person} {someone} {place} {elsewhere} {adj} {do} {did} {doing}
are filled from one topic; {n} is a small number and {time} a time of day. `|` ends a phrase, `...` is a hesitation.
Topics and templates of the two splits share no entry, so no sentence of one split can be spoken in the other.
"""

from __future__ import annotations

from dataclasses import dataclass

from gesticulator_performer.meaning_sentences import MEANING_SENTENCES


@dataclass(frozen=True)
class Topic:
    """The words of one everyday subject. Verbs are "base/past/-ing"; each takes a thing as its object."""

    name: str
    things: tuple[str, ...]
    people: tuple[str, ...]
    places: tuple[str, ...]
    verbs: tuple[tuple[str, str, str], ...]
    adjectives: tuple[str, ...]


def _topic(name: str, things: str, people: str, places: str, verbs: str, adjectives: str) -> Topic:
    split = [tuple(verb.split("/")) for verb in verbs.split()]
    triples = tuple((verb[0], verb[1], verb[2]) for verb in split)
    return Topic(name, tuple(things.split()), tuple(people.split()), tuple(places.split()), triples,
                 tuple(adjectives.split()))


TRAIN_TOPICS = (
    _topic("cooking", "soup kettle onion oven recipe spoon lemon sauce plate pepper pancake dumpling",
           "cook waiter grandmother guest baker", "kitchen market cellar bakery",
           "stir/stirred/stirring taste/tasted/tasting burn/burned/burning serve/served/serving",
           "salty fresh hot sweet bitter"),
    _topic("travel", "ticket suitcase train map passport platform bridge hotel tunnel ferry postcard bus",
           "driver traveller tourist guide pilot", "station airport border village",
           "miss/missed/missing book/booked/booking reach/reached/reaching photograph/photographed/photographing",
           "late crowded distant cheap narrow"),
    _topic("work", "report meeting desk contract letter budget project printer invoice form folder deadline",
           "manager colleague secretary customer lawyer", "office corridor bank factory",
           "sign/signed/signing finish/finished/finishing print/printed/printing discuss/discussed/discussing",
           "urgent boring careful expensive official"),
    _topic("weather", "storm cloud umbrella forecast rainbow puddle thunder breeze snowflake fog frost sunset",
           "sailor farmer neighbour reporter shepherd", "valley coast hillside meadow",
           "notice/noticed/noticing watch/watched/watching predict/predicted/predicting fear/feared/fearing",
           "grey cold windy gentle sudden"),
    _topic("family", "wedding birthday photograph cradle present sofa blanket diary cake toy ring necklace",
           "brother sister mother uncle cousin", "nursery balcony attic church",
           "plan/planned/planning wrap/wrapped/wrapping remember/remembered/remembering hide/hid/hiding",
           "old happy precious noisy pretty"),
    _topic("science", "experiment planet microscope theory comet crystal magnet molecule laser telescope formula virus",
           "professor student chemist doctor engineer", "laboratory library lecture observatory",
           "measure/measured/measuring study/studied/studying test/tested/testing explain/explained/explaining",
           "strange precise complicated invisible modern"),
    _topic("music", "piano song violin drum concert melody trumpet rehearsal guitar choir record microphone",
           "singer composer conductor dancer listener", "stage theatre studio cafe",
           "play/played/playing tune/tuned/tuning record/recorded/recording practise/practised/practising",
           "loud slow famous lively soft"),
    _topic("house", "door window ladder hammer carpet lamp shelf mirror curtain pipe roof staircase",
           "carpenter plumber landlord painter tenant", "bathroom garage bedroom hallway",
           "repair/repaired/repairing paint/painted/painting move/moved/moving clean/cleaned/cleaning",
           "broken dusty wooden heavy bright"),
    _topic("school", "lesson pencil exam notebook blackboard essay question dictionary bell uniform ruler lunchbox",
           "teacher pupil headmaster parent friend", "classroom playground canteen gymnasium",
           "learn/learned/learning copy/copied/copying correct/corrected/correcting lose/lost/losing",
           "difficult easy clever quiet patient"),
    _topic("animals", "rabbit horse spider parrot kitten wolf elephant turtle nest feather goat donkey",
           "ranger hunter keeper rider zoologist", "forest stable jungle farmyard",
           "feed/fed/feeding follow/followed/following protect/protected/protecting catch/caught/catching",
           "wild hungry tame curious fast"),
    _topic("health", "medicine bandage appointment fever injection prescription headache thermometer vitamin diet cough"
           " plaster",
           "nurse patient surgeon dentist pharmacist", "hospital clinic pharmacy ward",
           "treat/treated/treating check/checked/checking swallow/swallowed/swallowing describe/described/describing",
           "painful healthy serious mild dangerous"),
    _topic("city", "street traffic tower tram statue fountain taxi elevator square newspaper lantern crossing",
           "mayor policeman cyclist visitor shopkeeper", "museum park suburb harbour",
           "cross/crossed/crossing visit/visited/visiting build/built/building close/closed/closing",
           "busy dirty ancient elegant empty"),
    _topic("computers", "keyboard password message program screen robot battery network charger update cable mouse",
           "programmer user hacker designer tester", "server basement workshop archive",
           "install/installed/installing delete/deleted/deleting open/opened/opening send/sent/sending",
           "new useful slow private simple"),
    _topic("money", "price coin wallet receipt loan bargain tax salary auction fortune discount purse",
           "banker cashier dealer beggar millionaire", "shop counter agency marketplace",
           "pay/paid/paying count/counted/counting save/saved/saving borrow/borrowed/borrowing",
           "cheap costly fair tiny enormous"),
)
TEST_TOPICS = (
    _topic("garden", "rose shovel tomato fence hedge pumpkin bucket orchard wheelbarrow seed beehive sprinkler",
           "gardener grandfather florist beekeeper", "greenhouse shed lawn terrace",
           "plant/planted/planting water/watered/watering dig/dug/digging trim/trimmed/trimming",
           "green muddy ripe wild fragrant"),
    _topic("sport", "ball racket medal tournament helmet goal stopwatch trophy net bicycle jersey whistle",
           "coach runner goalkeeper referee", "stadium pool racetrack pitch",
           "throw/threw/throwing win/won/winning kick/kicked/kicking carry/carried/carrying",
           "quick tired strong brave proud"),
    _topic("sea", "boat lighthouse anchor wave shell dolphin net compass rope island lobster sail",
           "captain fisherman diver swimmer", "beach pier lagoon reef",
           "steer/steered/steering pull/pulled/pulling spot/spotted/spotting rescue/rescued/rescuing",
           "deep salty calm rough blue"),
    _topic("art", "painting brush sculpture canvas sketch pottery poster frame easel mosaic portrait palette",
           "artist sculptor curator model", "gallery atelier exhibition courtyard",
           "draw/drew/drawing sell/sold/selling admire/admired/admiring steal/stole/stealing",
           "colourful abstract beautiful pale bold"),
)

NUMBERS = ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "twelve", "twenty", "fifty")
TIMES = ("this morning", "yesterday", "last night", "on monday", "before noon", "tomorrow", "next week",
         "in the evening", "last winter", "on friday", "after lunch", "all summer")

_KINDS = """
statement
 the {person} {did} the {adj} {thing} near the {place}.
 {time} | the {person} {did} the {thing} and the {other}.
 the {thing} in the {place} looks {adj}.
 the {person} talked about the {adj} {thing} while the {someone} {did} the {other}.
 it was {adj} in the {place}, | so the {person} {did} the {thing} slowly.
 once more the {person} came back from the {place} | with {athing} and {athing2}.
 the {thing} belongs to the {person}.
 people say the {thing} was {adj} | long before the {person} {did} it.
 = {time} | another {person} {did} the {thing} in the {place}.
 = the {someone} told the {person} about {athing} | and about the {adj} {other}.
 = this kind of {thing} gets {adj} | after the {person} has gone.
question
 where did the {person} put the {thing}?
 did the {person} really {do} the {thing} {time}?
 who {did} the {adj} {thing} | before the {someone} came?
 how {adj} was the {thing} in the {place}?
 what would the {person} do with {athing}?
 have you ever seen {athing} | next to {athing2}?
 which {thing} did the {someone} like more, | the {adj} one or the other?
 why is the {thing} so {adj}?
 = who brought the {thing} to the {place}, | and what for?
 = what makes {athing} so {adj}?
 = could the {person} have {done} the {thing} alone?
negation
 no, | the {person} did not {do} the {thing}.
 the {thing} is not {adj} | and it never was.
 the {person} never {did} {athing} in the {place}.
 that is not the {thing} of the {person}.
 I don't want the {thing}, | not {time}, | not ever.
 nobody {did} the {thing}, | not even the {person}.
 they can't {do} the {thing} without the {person}.
 there wasn't a single {thing} in the {place}.
 = no, no, | nobody ever {did} {athing} like that.
 = the {person} won't {do} any more {things}.
 = it isn't the {thing}, | and it isn't the {other} either.
here
 the {thing} is right here.
 come here | and look at the {adj} {thing}.
 here in the {place} | we found the {thing}.
 here is the {thing} | that the {person} {did}.
 put the {thing} down here, | beside the {other}.
 = here stands the {adj} {thing} | of the {person}.
 = bring the {thing} over here at once.
there
 the {person} is over there | with the {thing}.
 there, | behind the {place}, | lies {athing}.
 look up there, | the {thing} is {adj}.
 there was once {athing} | in the {elsewhere} over there.
 go back there | and {do} the {thing}.
 = out there, | past the {place}, | somebody left {athing}.
 = the {adj} {thing} used to stand there.
left
 the {thing} is on the left | of the {place}.
 turn left at the {place} | and ask the {person}.
 to the left you see {athing}.
 on the left side | the {person} {did} the {thing}.
 the {adj} {thing} goes to the left.
 = keep left until you find the {thing}.
 = the left {thing} is more {adj} than this one.
right
 the {thing} is on the right | behind the {place}.
 turn right | when you see the {adj} {thing}.
 to the right there is {athing}.
 on the right side | stood the {person} with the {thing}.
 on the one side the {thing}, | on the right the {other}.
 = keep right, | the {place} is not far.
 = the right {thing} belongs to the {person}.
you
 you should {do} the {thing} {time}.
 you know the {person} from the {place}, | don't you?
 I told you about the {adj} {thing}.
 you and the {person} could {do} the {thing} together.
 this {thing} is for you.
 I ask you, | what is {athing} without {athing2}?
 = you never told the {person} about your {thing}.
 = all of this {thing} belongs to you.
me
 the {person} gave me the {thing}.
 it reminds me of the {adj} {thing} | in the {place}.
 for me the {thing} was {adj} from the start.
 my {thing} is more {adj} than my {other}.
 believe me, | I {did} the {thing} myself.
 I still remember the {thing} of my {person}.
 I {did} {athing} {time}.
 = let me {do} the {thing} for once.
 = my own {thing} was never so {adj}.
 = I alone {did} the {thing}.
we
 we {did} the {thing} together.
 we all know the {person} from the {place}.
 our {thing} is {adj}, | and so is our {other}.
 {time} we {did} the {thing} | with the {person}.
 between us we have {n} {things}.
 = let us {do} the {thing} {time}.
 = we both wanted the same {thing}.
this
 this {thing} is really {adj}.
 this is what the {person} {did} in the {place}.
 I like this {adj} {thing} | more than the {other}.
 look at this, | {athing} from the {place}.
 = in this {place} | everyone can {do} {athing}.
 = this one is {adj}, | this one is mine.
that
 that {thing} over the {place} is {adj}.
 that was the day | the {person} {did} the {thing}.
 that {person} knows nothing about {things}.
 who gave that {thing} to the {person}?
 = that is why the {thing} is still {adj}.
 = I would not touch that {adj} {thing}.
contrast
 the {thing} is {adj}, | but the {other} is not.
 the {person} {did} the {thing}. | however, | the {someone} wanted the {other}.
 on the one hand the {thing} is {adj}, | on the other hand the {person} likes it.
 it looks like {athing}, | but it is really {athing2}.
 the {thing} was {adj}, | and yet the {person} {did} it.
 although the {person} {did} the {thing}, | the {place} stayed {adj}.
 however {adj} the {thing} may be, | the {person} likes it.
 not the {thing}, | but the {other}, | was {adj}.
 = the {person} loves the {thing}, | but hates the {other}.
 = some want the {thing}. | however, | most of them take the {other}.
 = on the other hand, | {athing} can be very {adj}.
enumeration
 first you {do} the {thing}, | second you call the {person}, | third you leave the {place}.
 there are {n} {things}, | {n2} {things2}, | and one {adj} {person}.
 first came the {person}, | then the {someone}, | and finally the {thing}.
 one {thing}, | two {things2}, | three {things}, | that is enough.
 the {thing}, | the {other}, | the {place}, | they were all {adj}.
 besides the {thing}, | there is also the {other}.
 first of all, | the {thing} is {adj}. | secondly, | the {person} is tired.
 = the first {thing} is {adj}, | the second is gone, | and the third is mine.
 = besides that, | the {person} also {did} {n} {things}.
 = one for the {person}, | two for the {someone}, | three for the {place}.
all
 all the {things} in the {place} are {adj}.
 everything depends on the {thing}.
 everybody {did} the {thing}, | everybody.
 the whole {place} was full of {things}.
 all of them | wanted the {adj} {thing}.
 every single {thing} was {adj}.
 the {person} took everything, | the {thing}, | the {other}, | all of it.
 all around the {place} | you could see {things}.
 = always and everywhere | the {person} needs the {thing}.
 = the entire {place} | talked about the {thing}.
 = all {things} are {adj} in the end.
nothing
 there is nothing left of the {thing}.
 nothing in the {place} was {adj}.
 the {person} {did} nothing {time}.
 the {place} was empty, | completely empty.
 there was no {thing}, | no {other}, | nothing at all.
 = nothing is more {adj} than {athing}.
 = we found nothing but {athing}.
size
 the {thing} was huge, | bigger than the {place}.
 {athing} as big as a house | stood in the {place}.
 the {person} has a tiny {thing}.
 a very small {thing} | can be very {adj}.
 the {thing} grew enormous | while the {person} {did} the {other}.
 such a wide {place} | for such a little {thing}.
 they have far too many {things}.
 = it was a gigantic {thing}, | truly gigantic.
 = just a little bit of the {thing} is left.
 = the {place} is large, | the {thing} is small.
doubt
 maybe the {person} {did} the {thing}.
 perhaps the {thing} is {adj}, | perhaps not.
 I don't know | where the {person} put the {thing}.
 I think the {thing} was {adj}.
 I am not sure | whether the {person} can {do} the {thing}.
 it could be {athing}, | or maybe {athing2}.
 I wonder what the {person} thinks about the {thing}.
 who knows, | the {thing} might be {adj}.
 whatever the {person} says, | I have no idea.
 = I guess the {person} will {do} the {thing} some day.
 = maybe it was never {adj}, | I don't know.
 = I suppose | the {thing} is somewhere in the {place}.
plea
 please {do} the {thing}.
 please, | tell the {person} about the {thing}.
 I beg you, | don't {do} the {thing} again.
 could you please bring the {thing} to the {place}?
 help the {person}, please, | the {thing} is {adj}.
 = please don't take my {thing}.
 = oh please, | let the {person} {do} it.
stop
 stop, | the {thing} is {adj}!
 wait, | don't {do} the {thing} yet.
 stop {doing} the {thing} | and listen to the {person}.
 that is enough | about the {thing} in the {place}.
 hold on, | who {did} the {thing}?
 = stop it, | you can't {do} {athing} in the {place}!
 = wait a moment, | the {thing} is still {adj}.
yes
 yes, | the {person} {did} the {thing}.
 yes, yes, | the {thing} is {adj}.
 exactly, | that is the {thing} I meant.
 of course the {person} can {do} the {thing}.
 sure, | take the {thing} to the {place}.
 = yes, | I would {do} {athing} again.
 = that's right, | the {place} is {adj}.
safe
 the {thing} is safe in the {place}.
 don't worry, | the {person} is safe and calm now.
 it is over, | the {thing} is finished.
 = you are safe with the {person}.
 = everything is fine, | the {thing} is safe.
example
 take for example the {thing} | of the {person}.
 for example, | the {person} {did} the {adj} {thing}.
 many {things} are {adj}, | for instance the one in the {place}.
 let me give you an example, | imagine {athing} in the {place}.
 = for example, | think of {athing} and {athing2}.
 = some {things}, | for example mine, | are {adj}.
when
 when the {person} {did} the {thing}, | the {place} was {adj}.
 {time} the {thing} was still {adj}.
 now is the time | to {do} the {thing}.
 after {n} hours | the {person} {did} the {thing}.
 it took {n} days | until the {thing} was {adj}.
 by the time we reached the {place}, | the {thing} was gone.
 = {time} the {person} had {n} {things}.
 = when does the {person} {do} the {thing}?
 = soon the {thing} will be {adj}.
offer
 would you like {athing} | or {athing2}?
 take the {thing}, | it is yours.
 the {person} offered the {someone} {athing}.
 the {person} received the {thing} with both hands.
 = I can give you {athing} for the {place}.
 = have one of these {adj} {things}.
away
 throw the {thing} away.
 forget about the {thing}, | it is {adj} anyway.
 never mind the {thing}, | the {person} will {do} it.
 = get rid of the {adj} {thing}.
 = who cares about {athing} in the {place}?
"""

OPENERS = ("well,", "um ...", "so,", "now,", "you know,", "well ...", "and", "um,", "anyway,", "listen,", "look,",
           "actually,", "honestly,", "uh ...", "okay,", "I mean,")
TEST_OPENERS = ("hm ...", "right,", "see,", "er ...", "then,")


def templates(lines: str, held_out: bool) -> dict[str, tuple[str, ...]]:
    """Templates by kind: those that are held out for test, or the others."""
    kinds: dict[str, list[str]] = {}
    kind = ""
    for line in lines.strip().splitlines():
        if not line.startswith(" "):
            kind = line
            kinds[kind] = []
        elif line.startswith(" =") == held_out:
            kinds[kind].append(line.removeprefix(" =").strip())
    return {kind: tuple(lines) for kind, lines in kinds.items()}


TRAIN_TEMPLATES = templates(_KINDS, held_out=False)
TEST_TEMPLATES = templates(_KINDS, held_out=True)
TRAIN_MEANINGS = templates(MEANING_SENTENCES, held_out=False)
TEST_MEANINGS = templates(MEANING_SENTENCES, held_out=True)
"""Templates whose words call for a gesture with a meaning, by its label."""
_COMMON = frozenset({"point_self", "point_you", "we_all", "point_there"})
"""Labels whose cues occur in the other sentences, too."""
_RARE = frozenset({"add_beside", "box_frame", "cheer_arms", "chin_think", "clap", "nod", "palms_question", "receive",
                   "throw_away", "usher", "wave_hello"})
"""Labels whose cues hardly occur elsewhere, or weigh little."""
MEANING_KINDS = tuple(label for label in TRAIN_MEANINGS
                      for _ in range(2 if label in _COMMON else 9 if label in _RARE else 5))
"""The labels to draw a sentence's from, each as often as it needs to be."""
