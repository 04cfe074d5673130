"""Our own sentences in German and Spanish: the performer does not understand their words, and follows stress alone.

Slots are drawn from the lists of the same name; a digit after the name asks for another entry of that list.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Phrasebook:
    """slots: name -> entries; templates: sentences with slots; openers: words a sentence may begin with."""

    slots: dict[str, tuple[str, ...]]
    templates: tuple[str, ...]
    openers: tuple[str, ...]


def _book(slots: dict[str, str], templates: str, openers: str) -> Phrasebook:
    entries = {name: tuple(entry.strip() for entry in line.split(",")) for name, line in slots.items()}
    lines = tuple(line.strip() for line in templates.strip().splitlines())
    return Phrasebook(entries, lines, tuple(openers.split("/")))


_DE_TRAIN = _book(
    {"wer": "der Nachbar, die Lehrerin, mein Bruder, unsere Köchin, der Fahrer, die Ärztin, der Bäcker, eine Freundin, "
            "der Gärtner, das Kind, der Verkäufer, die Malerin",
     "was": "den Schlüssel, das Fenster, die Lampe, den Koffer, das Buch, die Suppe, den Brief, das Fahrrad, die Uhr, "
            "den Teppich, das Klavier, die Leiter, den Hammer, das Brot, die Decke, den Spiegel",
     "ort": "im Garten, auf dem Markt, am Bahnhof, in der Küche, hinter dem Haus, neben der Brücke, im Keller, auf der "
            "Treppe, am Fluss, in der Schule",
     "tat": "suchte, fand, brachte, reparierte, verkaufte, vergaß, holte, bemalte, zeigte, kaufte",
     "wann": "gestern, heute früh, am Abend, letzte Woche, nach dem Essen, vor einem Jahr, am Montag, im Winter",
     "wie": "schnell, langsam, vorsichtig, heimlich, gerne, ungern, sorgfältig, plötzlich"},
    """{wann} {tat} {wer} {was} {ort}.
    {wer} {tat} {was}, | aber {wer2} {tat2} {was2}.
    nein, | {wer} {tat} {was} nicht.
    warum {tat} {wer} {wann} {was}?
    vielleicht {tat} {wer} {wie} {was}, | ich weiß es nicht.
    {ort} {tat} {wer} {wie} {was}.
    zuerst {tat} {wer} {was}, | dann {was2}, | und am Ende {was3}.
    alle sahen, | wie {wer} {wann} {was} {tat}.
    niemand {tat} {was}, | nicht einmal {wer}.
    bitte, | zeig mir {was} {ort}.
    hier {ort} | {tat} {wer} {was}.
    {wer} sah {was} {ort}, | und {wer2} sah {was2} {ort2}.""",
    "also,/nun ja,/ähm ... /schau,/ja,")
_DE_TEST = _book(
    {"wer": "der Kapitän, die Tänzerin, mein Onkel, der Förster, die Sängerin, ein Fremder, "
            "die Richterin, der Schneider",
     "was": "den Anker, das Segel, die Trommel, den Hut, das Messer, die Münze, den Kuchen, das Netz, "
            "die Flasche, den Baum",
     "ort": "am Strand, im Wald, auf dem Schiff, in der Stadt, vor dem Tor, unter dem Dach",
     "tat": "verlor, trug, malte, versteckte, öffnete, wusch",
     "wann": "morgens, im Sommer, am Freitag, vor langer Zeit, um Mitternacht"},
    """dort {ort} | {tat} {wer} {was}.
    ich glaube, | {wer} {tat} {wann} {was}.
    wer {tat} {was} {ort}?
    nicht {was}, | sondern {was2} | {tat} {wer} {wann}.
    {wer} {tat} alles, | {was}, | {was2} | und auch {was3}.
    {wann} war {wer} {ort} | und {tat} {was}.""",
    "tja,/nun,/hm ...")
_ES_TRAIN = _book(
    {"quien": "el vecino, la maestra, mi hermano, la cocinera, el cartero, la doctora, el panadero, una amiga, "
              "el pintor, la abuela, el vendedor, la niña",
     "cosa": "la llave, el libro, la lámpara, el reloj, la maleta, el pan, la carta, el espejo, la silla, el sombrero, "
             "la guitarra, el cuchillo, la manta, el mapa, la escalera, el queso",
     "donde": "en el jardín, en la cocina, cerca del río, detrás de la casa, en la plaza, en el mercado, "
              "junto al puente, en la escuela, bajo la mesa, en la estación",
     "hizo": "buscó, encontró, trajo, arregló, vendió, olvidó, compró, pintó, mostró, escondió",
     "cuando": "ayer, esta mañana, por la noche, la semana pasada, después de comer, hace un año, "
                "el lunes, en invierno",
     "como": "despacio, con cuidado, deprisa, en secreto, con alegría, de repente"},
    """{cuando} {quien} {hizo} {cosa} {donde}.
    {quien} {hizo} {cosa}, | pero {quien2} {hizo2} {cosa2}.
    no, | {quien} no {hizo} {cosa}.
    ¿por qué {hizo} {quien} {cosa} {cuando}?
    quizás {quien} {hizo} {cosa} {como}, | no lo sé.
    {donde} | {quien} {hizo} {cosa} {como}.
    primero {quien} {hizo} {cosa}, | luego {cosa2}, | y al final {cosa3}.
    todos vieron | cómo {quien} {hizo} {cosa}.
    nadie {hizo} {cosa}, | ni siquiera {quien}.
    por favor, | dame {cosa} {donde}.
    aquí, {donde}, | {quien} {hizo} {cosa}.
    {quien} vio {cosa} {donde}, | y {quien2} vio {cosa2} {donde2}.""",
    "bueno,/pues,/eh .../mira,/sí,")
_ES_TEST = _book(
    {"quien": "el capitán, la cantante, mi tío, el sastre, la jueza, un extraño, la bailarina, el pastor",
     "cosa": "el barco, la moneda, el tambor, la botella, el árbol, la red, el pastel, la vela, el anillo, la puerta",
     "donde": "en la playa, en el bosque, en la torre, delante del castillo, sobre la colina",
     "hizo": "perdió, llevó, lavó, abrió, dibujó, robó",
     "cuando": "en verano, el viernes, a medianoche, hace mucho tiempo, por la tarde"},
    """allí, {donde}, | {quien} {hizo} {cosa}.
    creo que {quien} {hizo} {cosa} {cuando}.
    ¿quién {hizo} {cosa} {donde}?
    no {cosa}, | sino {cosa2} | {hizo} {quien} {cuando}.
    {quien} lo {hizo} todo, | {cosa}, | {cosa2} | y también {cosa3}.
    {cuando} | {quien} estaba {donde} | y {hizo} {cosa}.""",
    "vaya,/entonces,/hm ...")

PHRASEBOOKS = {("de", "train"): _DE_TRAIN, ("de", "test"): _DE_TEST,
               ("es", "train"): _ES_TRAIN, ("es", "test"): _ES_TEST}
