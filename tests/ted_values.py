"""Bytes that `pyarrow.serialize` itself wrote, by version 0.14.1 (that of the published TED data) and 10.0.1.

VIDEO: vid "-aB_1" and two clips. The first lacks a joint. The second has 50 frames from 10 to 12 s, the mean pose of
the public configuration with joint 6 raised by 0.3 (Y is down) from frame 25 on; its sound is a square wave, its words
are "and" (9.9 to 10.2 s) and "so" (10.5 to 10.75 s). EMPTY: a video without clips. PICKLED: a clip that is an object
whose unpickling makes the folder `made_by_a_pickle`.
"""

import base64
import zlib

MEAN_POSE = (
    (0.0000306, 0.0004946, 0.0008437), (0.0033759, -0.2051629, -0.0143453), (0.0031566, -0.3054764, 0.0411491),
    (0.0029072, -0.4254303, -0.001311), (-0.1458413, -0.1505532, -0.0138192), (-0.2835603, 0.0670333, 0.0107002),
    (-0.2280813, 0.112117, 0.2087789), (0.1523502, -0.1521499, -0.0161503), (0.291909, 0.0644232, 0.0040145),
    (0.2452035, 0.1115339, 0.2051307),
)


def unpacked(text: str) -> bytes:
    """The bytes of one of the texts below."""
    return zlib.decompress(base64.b85decode(text))


VIDEO_014 = (
    "c-rmUPiPcZ9Ki86Gn-_pV~DWo8a)K8u(Z}_8`@~xC6rP;q-~Iv=1?1BH=3={1QT1K3IRi@G%Xe?D8wQ?3H8u|hgz1Qg&s<&U<(BW5upk>w2+HZ"
    "QtS3NGjBGtZ#N`GOE2H|@$LM1zj?nmZzr>xU7}J-HK_SgN-5P6t}RoZYLqrt)}&aDY%AGv<uRonWw&15_^Vu&t>#gEeB73in!X>lRrUqNi}rb)"
    "Mtsn(lD17z`wCAQ(z@N2I_X3)k4t-R6w^H9RL6A4_Ig=PCGy%jZ;;~yojc{!<~}BE7j(bZ?Amj=Rp(r;>Hf~!wf+4hZGY->8Mmv)>Dp1uthBHH"
    "JIeXH6^%Wm>(^2zq`n%Qv(!C*&*x7i&MD|mPDd4@c01_9OT=6(2m6)Pt>d>!Jr%_|86$S?L9pKr<DLt~p!*E+rxS6m9ObH}=sA;sHa(859ZLNk"
    "9pj~~+Bvx;ZQg_Ed}mbc9KZ0Oc8+&M`@AnzZGT&&?G4@Eq^h3dUKP#fnFsZ+g-@gXPMdLVO0IoZYGb%QKNsIe@eOHX&MwLRAf`j_D~=ByjB{*T"
    "U|(D^<!J0Zb>^bCTss##%k{_5S)Lz5T#|Xi=VnX&u}m+}=Tx0Of6(I{(qoLrwnbkPjruNOj=M!>IGEF>Fhh&J&sYta#Cb<!PF0Ru%DD^|$HwEB"
    "o`&do4DT^&wZ4OSVMgUR;dsx-7l7Q^GSZUL_qb_&Kd=%xJJrI)U0~T_#I+dh8KZrn?Kr;8*v=a9StC!U5#MdZcN^_HjqP3|zSn5)Gq(2_@q3K+"
    "A)|fBXdgAUj~ekujr04!XkTbMjz43}%T*)(syT1^0+@*VvyA>Nqkqfj--y3z#NRU7<L&tTXN>JxBYxKCuW~~(wky}AU431(8S(LU+}{@C_)a4}"
    "-j1)!KBK+Q$Tw=Vj~d6HGTKkswLeE|jGs$YXWM?r?T77u#Y1lY+wnFo(w;K58y0D|)zZpB^X4S3nRkkXw}y+OV>Oeg$MMv_^Zi>F>93*A9GP+P"
    "`<|4J59XvvkK?iM4zJX5{hF4{zfx+eeowVYzaPp;eNo@<-jw>b)Zm5XnACSi4j0D84h#+tj*lD~>wl&&aHLQi=|4R1?%4Ri;qm_Q;=#eeLxpg;"
    "aBQ@)Z*X8dI%?nHfrEqnhem=U<MrD9qLa03c^6_?j$_+(=E|xwALbk__FN~Q$I7*3S;4=m7_(0&acvD8DvXWD^2$#^+0eZ&ERXA#oQ=_PB3jlP"
    "Z&W&T{Ihx)AD``>(-E62^+?Knm3+U@TK#@OenANCQJGcABbw#)wkeDW-p@4aDY&Tb|H;?#<Z;0{4p;J2|NI4QJ^FP#*f%5Zue>_XnJXDx{kxZ^"
    "ukY&ibfrDGcRpQnw#oOj(F9KPsm|pWtnJ@ExqEv@es|Zl)w}$U+ykY1H(&1Bzkk}l`(ZYB`TcyC`sKQR<JT{~8Ge10|Jf6*{vXA?rJpx{;(xdE"
    "WbXDW?K?JpT=dVLyOZ1S<7@e^to8Z!E9?BvUz#kfJ#sqVJ9{Fxa_U4ExyVH>a*>N%<RTZj$n{_48Y*=A<RTZj$VD!4k&9g9BG*!LE%o!`(h@#D"
    "R&$Gge%z-&|E>Bic&_%lj(FXx^Lem3ZhpU$s`-wmrgQ)R000000000000000000000000003a>_0000000000000000000000000001EP3w!_o"
    "0000000000000000000000000K!Cr%2LJ#7000000000000000000000001p`%0;_ii)RNRikQ9uB>^%j+CR?WHGu%B}%i(s-`feMUHHab~+d3"
    "p;Kxm5t%&Bk$SX}Cn~8#TaVPN-ZxV&mp#2dSzO8JN`$NXSXR@XuC%vEeOj5NQQ8_sP^|EAqEB@$zhG_u_Q~DbJMz1`wyoaff8-u0-Mjg6*Z%#}"
    "{@o9=xy$e8yVNh&{Tsi2@y+n-tNhQNX!ZXn?k)Yi`4j)UohNg*Uuoa5@#CU@_S~J^h96(ce`T%Dw_jQ3fBw>BY3-5I`QF(Rxs_8Vy3VhDFaO(t"
    "+qoZB?8=juyyPV>dC5y&@{*Ul<o$p04i&n6@{*Ul<Rve8$xB}Hl9#-XKCk(Sd}#^aKd8CIzkle{-ybBue@Gq|eA;g(*1bC4C#d7qV@rh=Df|z{"
    "0000000000000000000000000004jh|A#RE000000000000000000000000003g6$-~#{v00000000000000000000000000{jI&0000000000"
    "000000000000000002PTS4yQ-R6NzH8dZaGWz7qAq#V^Ii*A)H%_^&!!k890vN_u6Ovpor)J!5Wd7LfPO{^#PXM<EyXUgTWr`MCkl}xVeb;B{v"
    "_Y;>?=>IAI0I=9X<^"
)
EMPTY_014 = (
    "c-o~>u};G<5WOS~n986G6=Y!O*s(|*V9UV3z|f%s14AUJlt`^qsSy$q10T?_BOk%o4`5*66Bzjp!kv8y?$M|qPI8=g@A;m6Ho$tce1OROwL!xU"
    "grM*b!wV1tB1J0xVw&gWXIUaTSb27R#l<+@ELZ0!UTjW33O&_bA@^bV{ShWR%==V}HSfr)(t19_y5<4LF^=={+t+7b@<?o6U&2rC0dgtV?IPC9"
    "Q!Jf&!1=rwPpi6TIG(H~?1;4s%#&u|^!k;3GVW8gkG|Opb>DVd_AbKHDr9$!L&W#xg|TxUyT4Yw&h>ToO?^4(+uS6d7nSDPw><@OjzfM4+BiZG"
    "nEhsT#WrGXUIo3C1>dRXcpgD>sD?Qbx=8S`;G1xz?+V-#`kwGP75YTz6Tx2yJQVt&;I9Nug+3L0CircbVo%%yY{33M@wWQEji$PR(}TPG_GXgL"
    "=9^4H9OLP%xc`Ia7x+g{&;"
)
VIDEO_100 = (
    "c-"
    "rmUUuaxa9>DQ)XKp65b{eLTcE=dlLR%QLYg;$F#KsxIB1;~shJu&}Ym83X&Su(#W~yCQA<!Z#R;i$%P^HK|6zqe74^_gY!m^08pt8aWK^BbAhZ"
    "XX$N=Zy-f9KwFGiOe2dn?^PFW>X==KeXqbAIQZduMJsLsTj%U1r^qQqCz=4EOF(1(lP!ylhGFeA!pBmzSTu`6-"
    "9ZdStoPlD(diY;QHkGP1lUotMpiqdwczT`fehYcb07b2>U+=#}k~)ql~%?b)N$oWy((#cgzRos*4TvtMsc9?|{2C$WoWZ2hvo-PC7g*(V#@W!Y"
    "(tJu}gm)oq?zX^$^!jZf#;y^=D<-O{JTjIAWk$C+$<KH@R{b0v8`&aR}-"
    "#~F$F%S!TmypdTyAD1NdUuJB2F5+|7_rQY^|A`)>EHzmMoOyZe$M!h8oO#Kb*wH8^qsJKMj^pl=<w8r>D{olOa}=9RiXD{Yuh(^bM*Z39v)_sf"
    "=it}+o-D}H9p00=xt@c+|CoNAF6)@p<m=Syt-nsMttMZm2UpW`4N6R7HTga~CClU1wTSci*Kd3uUR-U@U1{Ci<zy~$BATVeD7GtUo@M&f-"
    "=sbt<?@nZWcccu#OzFo>6iM^l$c?uZ(dKH^HJ5F^Qp-{g!f#&l|1JcuiyNf&P)A5%2+Pz`qs^3mLz6-"
    ">*l$7rG6x(pFyc_wA$xgw$6LZ#B`i@`0krG_jJPfr;O>m)Gwrr>9W)prAFT?-"
    "Ql}?(Y*IZZAuAk{80OOG13+FtxG{|F;9#_*qh4wVISw>fy<MmBsIQyru1i{*NCUuWw*5*A2+Y-wY){uS&B|v$*C_{?-$D4b9Q{$i7&66PgDk-"
    "_+h8N5vP9C>2K7jA9J3&Pdf2WI`M~{d^1k{38(!DXZ(M1>f`;5X8nd)51935PW)%?JeUjfT-=}M^yfMKc}{;`=lK5Nb)Mf<uk-wtoc2pj`?z5)"
    "9$%*Ox^K;NwvYGY_PaBk*JIF$kN4yIX3VLN_v6>Wj8i}3v_Iq2$NTnu{R`)HkyPCJOv=8x&3Nx8=1<GFF=b!fX8i5WNA4%a`_6t>N_{3}KI0hA"
    "TOX6PULViYYfm@oGqYa83F<NYa^kn+ds6!AvgXsX%ME_d>oW7xZN~Al@ZDXh4fgBO#BGwL&-"
    "~7#f5*{dsmSs>^WOM`EWekfY2H(wojz8Zot>I&Og5*F&W``8HgUXGpB_Ip@$77K;#hOMSwAv4d9)U;ZyXzK9GskJMy(DWn>aE#eso&5jJMbK7o"
    "KY-lg-MHjPGZ&3D?I<m=AZ3lCJZOu48<kNlN*zGsf*RYu#59M{Bdwvc7Uzmu<rb!?N8xo_0j*xoDj<Uh^((;(ue-ar^S{vWeK~wV(HPOTB+h+0"
    "XyJ&gZ}Hhwpi%&33CEdA@dsG5U9p9&=h3%=5*5cH8arxEs!M&A00IS-(?Vm2njku0vij=FPud3+A5ftnXc`FPeX^xbFz<-"
    ">W?}H>L(RocH!#y63>&f$D*w`?u^5Ud~U=|M2z0Lx&EX4ZeS=T>0>Y>X7>4t6<^FcRy-8wmEqF?!Mr=`cw0t-"
    "}`Ft@yLsn#Yc8Mu;Z0_@a9|JR<?cmX!U)szq;$nUBNpKotnS%`0LftrIVFSr%w)%i(KR)7rDqqE^?8JT>q_Hhik(DxyVH>a*>N%<RTZj$aSl^)"
    "GZeM`SHbD`21Kcr+<DtW<LMz`0jVP^RsmO`}0D==fUcE_xl=u-"
    "FG&fADsgL000000000000000000000000003bd90000000000000000000000000002Pn7x(}G00000000000000000000000000FA%E2LJ#70"
    "00000000000000000000001pmXvEssa_S8g6dN_)ur;XRnP}~Uu~7u%+HlodQ@3;hcQKI*%KYiUXUMyvXrbyyIoe66Ki>*;#+n5WGS0tS7lrUb"
    "KEX@$(Wajyy@ePb@jb#^+j3kQ*OygT~6rYskt#VxZ%9F_tHHF_6}4J4BfwFfADgCYW|0>A09e%=xp%)OXbRkFI0!r7heSnU%vZM<FU=b+jsW`-"
    "_@U*|NP!pgO5jEtSmmV>wz7w)PpzQ`nIy|(?_fCd;Qg2SMCbldFa&qoyT9VjxL?7Y&v~%=-"
    "ie+R==5AtbDR@f0exCB`<l&OJ4Glm%QX9@Bb(7;o5LOUh<NcyyPV>dC5y&@{;#IpV$2~UVr~^@fN;+P|NAxKa8305A5$B>~@|k8Ed<c@O^@MzH"
    "@wj=q82#gE0UA0000000000000000000000000K;!>m3;+NC000000000000000000000002c_zQdh00000000000000000000000000D#6{-"
    "~#{v0000000000000000000000000L`%vwrBttqN<sChoa$0}*(&G*zOS~*YFOE&N0n7~7*mv%J<-"
    "AJoctJ&rDR3g?J~0Dt!?{wS*Mcas*I;#w(XLaOnEt)569T<CoX>Ie_#F$Jinpc"
)
EMPTY_100 = (
    "c-"
    "o~@u}%U(5S`@?y^w=kA~6&c6ckrjNTLa)g$0ELg#{%>NhBT#350~d@B{n+Kfr<yu=EowEG;Z7ZRC8rI|u7{$!Q#NyZd(Dyq%k!gXp`ZuvLjDGN"
    "?i!?NFHltYFFqCZGVL&m*>Ze)vpNpjrd#7VkldPBFxclkse>rFv__-EfF?KCDJq$GYL@N6hPVh~B_y+4!nF>j>mJ<MDhn(Yj4=`<7p80=L=k;d"
    "#Nc!gIiTi;HBYV_u#7JSRVW#@)Ig$3vo9a31+g&1*Wmw#e^1-JYeKivUtuGkc#b2guVqwA+?b&f^^GJ@|VCI$ijabbD{HQ_BH!G`<-vO<e-"
    "h5w-*J?r&9)(>?sp1vx#zAHfsgq+Qc-"
    "5%;5wY2?KC=4bnNP_nw(LfYpJ4vi9dzKOrybbJLkG~KLw{7l(<RL(cC=d82+faffaNPI_;;5CFl!&&WGf*%Whym=pMUBN#QdOhLq3%$PZ4|p!~"
    "JQVz);9m>B#M-K&j(H~ir2<U<<f{Tqe~i!0RO%<kbLzDiUtK2S=}hG$sB1o&Oy^7SKm40~z5v$Ddp-"
)
PICKLED_100 = (
    "c-pO0y=&V*6u*<@R0P+EVp<IzJfvWXDGoH?F=K`frgX?qu+`W!!g4EW6YR}Pz=MZERmh*<v17-K9Xxi(kfB5VfDRc7wXMGUvM(<ei;|u>-"
    "@W_&-shbjAvZ??V{8-Ra%r37$QH>G2X-*14Ke}Afqz^6!?9ei{v-"
    ")Vc@Op_d1k>Zz@{waFzEG}sll9cR~#bkl*M_j0DDif?@He8E+IwW)CKP$_GM?lpOk}syUXmp1nx-"
    "i^F@$%Bo0*a6_my>EAs5b4|`0<Tdd>DXz?*0v$Pnigq#ECdTy@AHC@+3#W-"
    "G=>rq>z*P{ZQ=E7W$Ik{brH^BWQ_<6=vv9LLXIf8izvx;g`S*~NWQB7Elu7u63tNB!%J(xcLcZ7{C69-"
    "ZuzkwtD*e1>km_@+rf<sLl7WY2j{iV77buH&kd&qNh5_A2(EjQ;h1^hB4mKnp7&75Dr*-"
    "1A0Dgb_vVy6apn5^?IYkBK;y2_h>;o^%n=ARPN6!6QGm}Y>xfH>gk0q-EL>@PycGw9g-C;E|R3%hLO$Ya@&a@-"
    "Qh*j&F#RR`M!Imf#b>sg^Cz7?wVxTo4)ojY<>ak!{2x`^i?T*<0-CB!cyetDIT7&XM-NA?a7UPt!o2tP#mH4(pw_{WGJp?VCE{s8HZ5Uym^JI5"
    "&BGsHhbb)L%gkzCJ_z3<501+sU6;`=GrJ#}9c-"
    "5<S~e+l7AUfrjZvl{0KdS|AAaVte8_vF)ml+*MxDKfbypZ<sVE#6sfb28ffodm6;Fo=58GRH7LGQA@=syU+QK5X8N#2aq;eLo70I$^sJ4g15W-"
    "H<xg-4$VPb!2~eCdElM`p^po@g&>rw1SWE=Xm0F{Z_m2cG&P6!gzcdzlxuuc-b3$eH^@hC;O@H<1eXg@9q"
)
