"""Explicit Runge-Kutta methods and pairs: their tableaus, as the books print them."""

from xdynamics.methods.lines import Interpolant, spread_over_vectors
from xdynamics.methods.method import Method
from xdynamics.methods.tableau import Tableau, weight_columns, weight_differences

_HEUN = Tableau.parse("""
    0  |
    1  |  1
   ----+-----------
    b  | 1/2   1/2
    b^ |  1     0
""")

HEUN = Method(
    name="heun",
    synonyms=("explicit trapezoidal rule", "improved Euler", "modified Euler", "second-order Runge-Kutta"),
    order=2,
    symplectic=False,
    evaluations=2,
    update=_HEUN.update,
    words="an Euler step, the force there, the step again with the mean of both slopes, then the force",
    reference=(
        "Heun 1900, Z. Math. Phys. 45, 23; Hairer, Norsett, Wanner I, section II.1; the embedded formula is Euler's"
    ),
    estimate=_HEUN.estimate,
    estimate_order=1,
)

_RK4 = Tableau.parse("""
    0   |
    1/2 | 1/2
    1/2 |  0   1/2
    1   |  0    0    1
   -----+--------------------
    b   | 1/6  2/6  2/6  1/6
""")

RK4 = Method(
    name="rk4",
    synonyms=("classical Runge-Kutta", "the Runge-Kutta method", "Kutta's method"),
    order=4,
    symplectic=False,
    evaluations=4,
    update=_RK4.update,
    words=(
        "the slope at the start, two at t + h/2 and one at t1, each from the one before, a step with their weighted"
        " mean, then the force"
    ),
    reference="Kutta 1901, Z. Math. Phys. 46, 435; Hairer, Norsett, Wanner I, section II.1, Table 1.2",
)

_BOGACKI_SHAMPINE = Tableau.parse("""
    0   |
    1/2 | 1/2
    3/4 |  0    3/4
    1   | 2/9   1/3  4/9
   -----+---------------------
    b   | 2/9   1/3  4/9   0
    b^  | 7/24  1/4  1/3  1/8
""")

BOGACKI_SHAMPINE = Method(
    name="bogacki_shampine",
    synonyms=("BS3(2)", "Bogacki-Shampine 3(2) pair"),
    order=3,
    symplectic=False,
    evaluations=3,
    update=_BOGACKI_SHAMPINE.update,
    words=(
        "slopes at t + h/2 and t + 3/4*h, a step with the weighted mean of three, then the force, which also enters the"
        " error estimate"
    ),
    reference="Bogacki, Shampine 1989, Appl. Math. Lett. 2, 321, doi:10.1016/0893-9659(89)90079-7",
    estimate=_BOGACKI_SHAMPINE.estimate,
    estimate_order=2,
)

# fmt: off
_DORMAND_PRINCE = Tableau.parse("""
    0    |
    1/5  |    1/5
    3/10 |    3/40         9/40
    4/5  |   44/45       -56/15       32/9
    8/9  | 19372/6561 -25360/2187  64448/6561  -212/729
    1    |  9017/3168   -355/33    46732/5247    49/176   -5103/18656
    1    |   35/384         0        500/1113   125/192   -2187/6784      11/84
   ------+---------------------------------------------------------------------------
    b    |   35/384         0        500/1113   125/192   -2187/6784      11/84    0
    b^   | 5179/57600       0       7571/16695  393/640  -92097/339200  187/2100  1/40
""")
# fmt: on

# Shampine's weights of the quartic term; HNW's (6.12) in the form that their code dopri5 evaluates
_D = (
    "-12715105075/11282082432", "0", "87487479700/32700410799", "-10690763975/1880347072",
    "701980252875/199316789632", "-1453857185/822651844", "69997945/29380423",
)  # fmt: skip

DORMAND_PRINCE = Method(
    name="dormand_prince",
    synonyms=("RK5(4)7M", "DOPRI5", "RK45", "ode45's method"),
    order=5,
    symplectic=False,
    evaluations=6,
    update=_DORMAND_PRINCE.update,
    words=(
        "five slopes inside the step and at t1, each from those before, a step with the weighted mean, then the force,"
        " which also enters the error estimate"
    ),
    reference=(
        "Dormand, Prince 1980, J. Comput. Appl. Math. 6, 19, doi:10.1016/0771-050X(80)90013-3; Hairer, Norsett, Wanner"
        " I, section II.5, Table 5.2; extension: Shampine 1986, Math. Comp. 46, 135,"
        " doi:10.1090/S0025-5718-1986-0815836-3; Hairer, Norsett, Wanner I, section II.6, eq. (6.12)"
    ),
    estimate=_DORMAND_PRINCE.estimate,
    estimate_order=4,
    interpolant=Interpolant(
        spread_over_vectors(f"""
        yi = y1 - y
        yj = h*k - yi
        yl = yi - h*k1 - yj
        ym = {_DORMAND_PRINCE.increment(_D)}
        ys = y + s*(yi + (1 - s)*(yj + s*(yl + (1 - s)*ym)))
    """),
        "quartic by Shampine's weights of the step's slopes, with slope k at its start and k1 at its end",
        order=4,
    ),
)

# The digits are those of Hairer's code dop853.f, which prints the simple fractions among the times as decimals. Its end
# is stage 13; stages 14 to 16 serve the extension only. Rows: i, j, weight.
DOP853_TABLEAU = Tableau.from_entries(
    """
    0  0.0526001519587677318785587544488  0.0789002279381515978178381316732
       0.118350341907227396726757197510   0.281649658092772603273242802490
    1/3  1/4  4/13  127/195  3/5  6/7  1  1  1/10  1/5  7/9
    """,
    """
     2  1     0.0526001519587677318785587544488
     3  1     0.0197250569845378994544595329183
     3  2     0.0591751709536136983633785987549
     4  1     0.0295875854768068491816892993775
     4  3     0.0887627564304205475450678981324
     5  1     0.241365134159266685502369798665
     5  3    -0.884549479328286085344864962717
     5  4     0.924834003261792003115737966543
     6  1     0.037037037037037037037037037037
     6  4     0.170828608729473871279604482173
     6  5     0.125467687566822425016691814123
     7  1     0.037109375
     7  4     0.170252211019544039314978060272
     7  5     0.0602165389804559606850219397283
     7  6    -0.017578125
     8  1     0.0370920001185047927108779319836
     8  4     0.170383925712239993810214054705
     8  5     0.107262030446373284651809199168
     8  6    -0.0153194377486244017527936158236
     8  7     0.00827378916381402288758473766002
     9  1     0.624110958716075717114429577812
     9  4    -3.36089262944694129406857109825
     9  5    -0.868219346841726006818189891453
     9  6    27.5920996994467083049415600797
     9  7    20.1540675504778934086186788979
     9  8   -43.4898841810699588477366255144
    10  1     0.477662536438264365890433908527
    10  4    -2.48811461997166764192642586468
    10  5    -0.590290826836842996371446475743
    10  6    21.2300514481811942347288949897
    10  7    15.2792336328824235832596922938
    10  8   -33.2882109689848629194453265587
    10  9    -0.0203312017085086261358222928593
    11  1    -0.93714243008598732571704021658
    11  4     5.18637242884406370830023853209
    11  5     1.09143734899672957818500254654
    11  6    -8.14978701074692612513997267357
    11  7   -18.5200656599969598641566180701
    11  8    22.7394870993505042818970056734
    11  9     2.49360555267965238987089396762
    11 10    -3.0467644718982195003823669022
    12  1     2.27331014751653820792359768449
    12  4   -10.5344954667372501984066689879
    12  5    -2.00087205822486249909675718444
    12  6   -17.9589318631187989172765950534
    12  7    27.9488845294199600508499808837
    12  8    -2.85899827713502369474065508674
    12  9    -8.87285693353062954433549289258
    12 10    12.3605671757943030647266201528
    12 11     0.643392746015763530355970484046
    13  1     0.0542937341165687622380535766363
    13  6     4.45031289275240888144113950566
    13  7     1.89151789931450038304281599044
    13  8    -5.8012039600105847814672114227
    13  9     0.31116436695781989440891606237
    13 10    -0.152160949662516078556178806805
    13 11     0.201365400804030348374776537501
    13 12     0.0447106157277725905176885569043
    14  1     0.0561675022830479523392909219681
    14  7     0.253500210216624811088794765333
    14  8    -0.246239037470802489917441475441
    14  9    -0.124191423263816360469010140626
    14 10     0.15329179827876569731206322685
    14 11     0.00820105229563468988491666602057
    14 12     0.00756789766054569976138603589584
    14 13    -0.008298
    15  1     0.0318346481635021405060768473261
    15  6     0.0283009096723667755288322961402
    15  7     0.0535419883074385676223797384372
    15  8    -0.0549237485713909884646569340306
    15 11    -0.000108347328697249322858509316994
    15 12     0.000382571090835658412954920192323
    15 13    -0.000340465008687404560802977114492
    15 14     0.141312443674632500278074618366
    16  1    -0.428896301583791923408573538692
    16  6    -4.69762141536116384314449447206
    16  7     7.68342119606259904184240953878
    16  8     4.06898981839711007970213554331
    16  9     0.356727187455281109270669543021
    16 13    -0.00139902416515901462129418009734
    16 14     2.9475147891527723389556272149
    16 15    -9.15095847217987001081870187138
    """,
    end=13,
)

# Rows: stage, the difference from the formula of order 5, the weights of the formula of order 3.
DOP853_FIFTH, DOP853_OF_THIRD = weight_columns(
    """
     1   0.01312004499419488073250102996   0.244094488188976377952755905512
     6  -1.225156446376204440720569753     0
     7  -0.4957589496572501915214079952    0
     8   1.664377182454986536961530415     0
     9  -0.3503288487499736816886487290    0.733846688281611857341361741547
    10   0.3341791187130174790297318841    0
    11   0.08192320648511571246570742613   0
    12  -0.02235530786388629525884427845   0.0220588235294117647058823529412
    """,
    stages=13,
)

# Rows: stage, the weights of the extension's terms of degree 4 to 7.
_D4, _D5, _D6, _D7 = weight_columns(
    """
     1    -8.4289382761090128651353491142      10.427508642579134603413151009       19.985053242002433820987653617      -25.693933462703749003312586129
     6     0.56671495351937776962531783590    242.28349177525818288430175319      -387.03730874935176555105901742      -154.18974869023643374053993627
     7    -3.0689499459498916912797304727     165.20045171727028198505394887      -189.17813819516756882830838328      -231.52937917604549567536039109
     8     2.3846676565120698287728149680    -374.54675472269020279518312152       527.80815920542364900561016686       357.63911791061412378285349910
     9     2.1170345824450282767155149946     -22.113666853125306036270938578      -11.573902539959630126141871134       93.405324183624310003907691704
    10    -0.87139158377797299206789907490      7.7334326684722638389603898808       6.8812326946963000169666922661     -37.458323136451633156875139351
    11     2.2404374302607882758541771650     -30.674084731089398182061213626       -1.0006050966910838403183860980     104.09964950896230045147246184
    12     0.63157877876946881815570249290     -9.3321305264302278729567221706       0.77771377980534432092869265740     29.840293426660503123344363579
    13    -0.088990336451333310820698117400    15.697238121770843886131091075       -2.7782057523535084065932004339     -43.533456590011143754432175058
    14    18.148505520854727256656404962      -31.139403219565177677282850411      -60.196695231264120758267380846       96.324553959188282948394950600
    15    -9.1946323924783554000451984436      -9.3529243588444783865713862664      84.320405506677161018159903784      -39.177261675615439165231486172
    16    -4.4360363875948939664310572000      35.816841486394083752465898540       11.992291136182789328035130030     -149.72683625798562581422125276
    """,
    stages=16,
)

DOP853 = Method(
    name="dop853",
    synonyms=("Dormand-Prince 8(5,3)", "Hairer's code of that name"),
    order=8,
    symplectic=False,
    evaluations=12,
    update=DOP853_TABLEAU.update,
    words=(
        "eleven slopes inside the step and at t1, each from those before, a step with the weighted mean, then the force"
    ),
    reference=(
        "Hairer, Norsett, Wanner I, sections II.5 and II.10 (error estimate, p. 254), section II.6 (extension, p. 194);"
        " coefficients by Dormand and Prince: Hairer's code dop853.f"
    ),
    # yu falls as h**6 and yw as h**4, so ye falls as h**8; the code combines norms, here it is done by component
    estimate=spread_over_vectors(f"""
        yu = {DOP853_TABLEAU.increment(DOP853_FIFTH)}
        yw = {DOP853_TABLEAU.increment(weight_differences(DOP853_TABLEAU.b, DOP853_OF_THIRD))}
        yz = yw/where(yu != 0, yu, 1)/10
        ye = yu/sqrt(1 + yz**2)
    """),
    estimate_order=7,
    interpolant=Interpolant(
        spread_over_vectors(
            f"{DOP853_TABLEAU.extra_stages}\n"
            "yi = y1 - y\n"
            "yj = h*k - yi\n"
            "yl = yi - h*k1 - yj\n"
            f"ym = {DOP853_TABLEAU.increment(_D4)}\n"
            f"yn = {DOP853_TABLEAU.increment(_D5)}\n"
            f"yo = {DOP853_TABLEAU.increment(_D6)}\n"
            f"yp = {DOP853_TABLEAU.increment(_D7)}\n"
            "ys = y + s*(yi + (1 - s)*(yj + s*(yl + (1 - s)*(ym + s*(yn + (1 - s)*(yo + s*yp))))))"
        ),
        "degree 7 by three more evaluations, with slope k at the step's start and k1 at its end",
        order=7,
    ),
)

METHODS = (HEUN, RK4, BOGACKI_SHAMPINE, DORMAND_PRINCE, DOP853)
