"""Sentences in German, Spanish and Mandarin. No meaning is attached to their words: the performer follows stress alone.

Slots are drawn from the lists of the same name; a digit after the name asks for another entry of that list. Mandarin
(cmn, ISO 639-3) is in simplified characters with spaces between its words, so that a voice knows the words.
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

_CMN_TRAIN = _book(
    {"shei": "老师, 医生, 邻居, 我 妹妹, 司机, 厨师, 那个 孩子, 奶奶, 我们 的 朋友, 画家, 校长, 那 位 客人",
     "shenme": "钥匙, 雨伞, 那 本 书, 一 封 信, 旧 自行车, 红色 的 箱子, 一 张 地图, 两 把 椅子, 新 手机, 毛衣, 镜子, "
               "三 块 面包, 梯子, 手表, 杯子, 桌布",
     "nali": "在 厨房 里, 在 学校 门口, 在 公园 里, 在 火车站, 在 桥 旁边, 在 房子 后面, 在 市场 上, 在 楼梯 下面, "
             "在 河边, 在 办公室",
     "zuole": "找到 了, 买到 了, 卖掉 了, 修好 了, 忘记 了, 带来 了, 画好 了, 洗好 了, 搬走 了, 借走 了",
     "zuo": "找, 买, 卖, 修, 带, 画, 洗, 搬, 借, 看",
     "heshi": "昨天, 今天 早上, 晚上, 上个 星期, 吃饭 以后, 一 年 以前, 星期一, 冬天",
     "zenme": "慢慢 地, 很 快 地, 小心 地, 悄悄 地, 高兴 地, 突然"},
    """{heshi} {shei} {nali} {zuole} {shenme}。
    {shei} {zuole} {shenme}， | 可是 {shei2} {zuole2} {shenme2}。
    不， | {shei} 没有 {zuo} {shenme}。
    {shei} 为什么 {heshi} {zuo} {shenme}？
    也许 {shei} {zenme} {zuole} {shenme}， | 我 不 知道。
    {nali}， | {shei} {zenme} {zuole} {shenme}。
    {shei} 先 {zuo} {shenme}， | 再 {zuo2} {shenme2}， | 最后 {zuo3} {shenme3}。
    大家 都 看见 | {shei} {heshi} {zuole} {shenme}。
    没有 人 {zuo} {shenme}， | 连 {shei} 也 没有。
    请 你 {nali} | 给 我 看 {shenme}。
    就 {nali}， | {shei} {zuole} {shenme}。
    {shei} {nali} 看见 {shenme}， | {shei2} {nali2} 看见 {shenme2}。""",
    "那么，/嗯 .../你 看，/好 吧，/其实，")
_CMN_TEST = _book(
    {"shei": "船长, 歌手, 叔叔, 裁缝, 法官, 一个 陌生人, 舞蹈 演员, 牧羊人",
     "shenme": "大 鼓, 硬币, 小 树, 瓶子, 渔网, 蛋糕, 蜡烛, 戒指, 木船, 帽子",
     "nali": "在 海边, 在 森林 里, 在 塔 上, 在 山坡 上, 在 城门 前面, 在 屋顶 下",
     "zuole": "丢 了, 拿走 了, 打开 了, 偷走 了, 扔掉 了, 收好 了",
     "heshi": "夏天, 星期五, 半夜 里, 很 久 以前, 下午, 中午"},
    """那边 {nali}， | {shei} {zuole} {shenme}。
    我 觉得 | {shei} {heshi} {zuole} {shenme}。
    是 谁 {nali} {zuole} {shenme}？
    不是 {shenme}， | 而是 {shenme2}， | {shei} {heshi} {zuole}。
    {shei} 什么 都 {zuole}， | {shenme}， | {shenme2}， | 还有 {shenme3}。
    {heshi} {shei} 站 {nali}， | {zuole} {shenme}。""",
    "哎，/所以，/呃 ...")

PHRASEBOOKS = {("de", "train"): _DE_TRAIN, ("de", "test"): _DE_TEST,
               ("es", "train"): _ES_TRAIN, ("es", "test"): _ES_TEST,
               ("cmn", "train"): _CMN_TRAIN, ("cmn", "test"): _CMN_TEST}
