"""Words for body parts and sides in German, Dutch, French, Spanish, Italian, Portuguese, Russian, Japanese, Chinese.

Artists name bones in the language that they speak. `english` replaces such words by those that
`gesticulator.characters.names` reads; a name in plain English stays as it is.
"""

from __future__ import annotations

import re
import unicodedata


def split(*lines: str) -> frozenset[str]:
    """The words of some lines."""
    return frozenset(word for line in lines for word in line.split())


LEFT = split("links linke linker linkes linkse gauche izquierda izquierdo izq sinistra sinistro sx esquerda esquerdo",
             "esq hidari zuo")
RIGHT = split("rechts rechte rechter rechtes rechtse droite droit derecha derecho dcha destra destro dx direita",
              "direito dir migi you")
"""Words for the sides, without accents."""

_LATIN = {english: words.split() for english, words in {
    "pelvis": "becken bassin bacino bacia bekken",
    "hips": "hanches caderas fianchi quadril",
    "hip": "hufte huefte hanche cadera anca heup",
    "spine": "wirbelsaule wirbelsaeule ruckgrat colonne columna colonna coluna ruggengraat wervelkolom",
    "back": "rucken ruecken dos espalda schiena costas rug",
    "belly": "bauch ventre vientre addome buik",
    "chest": "brust brustkorb poitrine pecho petto torace peito borst borstkas",
    "torso": "oberkorper oberkoerper torse tronco romp",
    "neck": "hals nacken cou cuello collo pescoco nek",
    "head": "kopf tete cabeza testa cabeca hoofd",
    "shoulder": "schulter epaule hombro spalla ombro schouder",
    "clavicle": "schlusselbein schluesselbein clavicule clavicula clavicola sleutelbeen",
    "upperarm": "oberarm bovenarm",
    "arm": "bras brazo braccio braco",
    "forearm": "unterarm avantbras antebrazo avambraccio antebraco onderarm",
    "elbow": "ellbogen ellenbogen coude codo gomito cotovelo elleboog",
    "hand": "main mano mao",
    "wrist": "handgelenk poignet muneca polso pulso punho pols",
    "thumb": "daumen pouce pulgar pollice polegar duim",
    "index": "zeigefinger indice indicador wijsvinger",
    "middle": "mittelfinger majeur medio corazon middelvinger",
    "ring": "ringfinger annulaire anular anulare anelar ringvinger",
    "pinky": "kleinerfinger auriculaire menique mignolo mindinho minimo pink",
    "thigh": "oberschenkel cuisse muslo coscia coxa bovenbeen dij",
    "leg": "bein jambe pierna gamba perna been",
    "shin": "unterschenkel schienbein espinilla canela onderbeen scheenbeen",
    "calf": "wade mollet pantorrilla polpaccio panturrilha kuit",
    "knee": "knie genou rodilla ginocchio joelho",
    "foot": "fuss pied pie piede pe voet",
    "ankle": "knochel knoechel cheville tobillo caviglia tornozelo enkel",
    "toe": "zeh zehe zehen orteil orteils dedospie ditapiede dedospe teen tenen",
}.items()}
WORDS = {word: english for english, words in _LATIN.items() for word in words}
"""Word in the Latin alphabet, without accents -> the English word."""

_RUSSIAN = {word: english for english, words in {
    "left": "левая левый левое лев", "right": "правая правый правое прав", "pelvis": "таз", "hips": "бедра",
    "thigh": "бедро", "spine": "позвоночник", "back": "спина", "chest": "грудь", "belly": "живот", "torso": "торс",
    "neck": "шея", "head": "голова", "clavicle": "ключица", "shoulder": "плечо", "arm": "рука",
    "forearm": "предплечье", "elbow": "локоть", "hand": "кисть ладонь", "wrist": "запястье", "thumb": "большой",
    "index": "указательный", "middle": "средний", "ring": "безымянный", "pinky": "мизинец", "leg": "нога",
    "shin": "голень", "knee": "колено", "foot": "стопа ступня", "ankle": "лодыжка", "toe": "носок", "": "палец",
    "hair": "волосы",
}.items() for word in words.split() or [""]}

_EASTERN = {word: english for english, words in {
    "left": "左", "right": "右",
    "hips": "センター 臀部 臀", "hip": "髋 髋部", "pelvis": "骨盆 盆骨 骨盤", "lower body": "下半身",
    "spine": "上半身 脊柱 脊椎 背骨", "waist": "腰 腰部", "belly": "腹 腹部", "chest": "胸 胸部",
    "neck": "首 颈 頸 脖子 颈部", "head": "頭 头 头部", "shoulder": "肩 肩膀 肩部", "clavicle": "锁骨 鎖骨",
    "upperarm": "上臂 大臂 上腕", "forearm": "前臂 小臂 下臂 前腕", "ude": "腕", "arm": "手臂",
    "elbow": "ひじ 肘 手肘", "wrist": "手首 手腕", "hand": "手 手掌 手部",
    "thumb": "親指 拇指 大拇指", "index": "人指 人差指 人差し指 食指", "middle": "中指", "ring": "薬指 无名指 無名指",
    "pinky": "小指 小拇指", "": "手指", "thigh": "太もも 大腿", "ashi": "足", "leg": "腿",
    "shin": "すね 小腿", "knee": "ひざ 膝 膝盖", "ankle": "足首 脚踝 踝", "foot": "脚 脚掌", "toe": "つま先 脚趾 趾",
    "hair": "髪 头发 頭髮", "twist": "捩", "eye": "目 眼 眼睛", "helper": "キャンセル",
}.items() for word in words.split()}
_EAST = re.compile("|".join(sorted(map(re.escape, _EASTERN), key=len, reverse=True)))
_CYRILLIC = re.compile("[а-яё]+", re.IGNORECASE)


def english(name: str) -> str:
    """The name with Japanese, Chinese and Russian words replaced by English ones, and without accents.

    >>> english("左ひじ"), english("Левая_кисть"), english("Épaule.G"), english("LeftArm")
    (' left  elbow ', 'left_hand', 'Epaule.G', 'LeftArm')
    """
    if name.isascii():
        return name
    text = unicodedata.normalize("NFKC", name)
    text = _EAST.sub(lambda found: f" {_EASTERN[found[0]]} ", text)
    text = _CYRILLIC.sub(lambda found: _RUSSIAN.get(found[0].lower(), found[0]), text)
    return "".join(letter for letter in unicodedata.normalize("NFKD", text.replace("ß", "ss"))
                   if not unicodedata.combining(letter))
