/* The functions that generated C carries along, each with its name and what it needs before it. */

/*: spans */
/* Where a segment stands: in which bytes, from where to where. */
struct fk_span {
    const uint8_t *data;
    size_t first, last;
    bool there;
};

/*: ends */
/* What measuring says beside a length, or how many bytes are wanted (below 0). */
#define FK_QUIET (-(INT64_C(1) << 40))
#define FK_LOST (FK_QUIET - 1)

/*: reader needs spans */
/* What was found out about a frame: the first fault, and the first wrong check code, which outweighs it. */
struct fk_notes {
    enum framekit_reason reason;
    size_t place;
    unsigned long turn, first_turn;
    int64_t refuse;
    bool wrong_check, unchecked, no_room;
    size_t check_place;
};

/* Bytes that are looked for. */
struct fk_stop {
    const char *data;
    size_t size;
};

/* What has to be known of a wrap to find where a byte of its content stands. */
struct fk_coding {
    uint8_t escape;
    const uint8_t *after;
    size_t after_size, insert_size, block, width;
    const struct fk_stop *embedded;
    size_t embedded_count;
};

/* Bytes that are read: those of a frame, or the content of a wrap, whose places `map` finds in what is around it. */
struct fk_in {
    const uint8_t *data;
    size_t at, end, from, start;
    struct fk_notes *notes;
    const struct fk_in *outer;
    size_t (*map)(const struct fk_in *, size_t);
    const uint8_t *raw;
    size_t raw_size;
    const struct fk_coding *how;
    bool quiet;
};

static void fk_open(struct fk_in *n, const uint8_t *data, size_t size, struct fk_notes *notes)
{
    memset(n, 0, sizeof *n);
    n->data = data;
    n->end = size;
    n->notes = notes;
}

static size_t fk_wire(const struct fk_in *n, size_t place)
{
    while (n->outer != NULL) {
        place = n->start + n->map(n, place);
        n = n->outer;
    }
    return place;
}

static void fk_note_at(struct fk_in *n, enum framekit_reason reason, size_t place, unsigned long turn, int64_t refuse)
{
    struct fk_notes *s = n->notes;
    if (n->quiet) {
        return;
    }
    if (s->reason == FRAMEKIT_OK || place < s->place || (place == s->place && turn < s->first_turn)) {
        s->reason = reason;
        s->place = place;
        s->first_turn = turn;
        s->refuse = refuse;
    }
}

static void fk_note(struct fk_in *n, enum framekit_reason reason, size_t place, int64_t refuse)
{
    fk_note_at(n, reason, fk_wire(n, place), n->notes->turn, refuse);
}

/*: wrong_check needs reader */
static void fk_wrong_check_at(struct fk_in *n, size_t place)
{
    struct fk_notes *s = n->notes;
    if (!s->wrong_check || place < s->check_place) {
        s->wrong_check = true;
        s->check_place = place;
    }
}

/*: take needs reader */
static bool fk_take(struct fk_in *n, int64_t size, int64_t refuse)
{
    n->from = n->at;
    if (size < 0) {
        fk_note(n, FRAMEKIT_LENGTH, n->at, refuse);
        return false;
    }
    if (n->at > n->end || (uint64_t)size > n->end - n->at) {
        fk_note(n, FRAMEKIT_SHORT, n->at, refuse);
        return false;
    }
    n->at += (size_t)size;
    return true;
}

/*: constant needs take */
static bool fk_constant(struct fk_in *n, const void *data, size_t size, int64_t refuse)
{
    n->notes->turn++;
    if (!fk_take(n, (int64_t)size, refuse)) {
        return false;
    }
    if (memcmp(n->data + n->from, data, size) != 0) {
        fk_note(n, FRAMEKIT_CONSTANT, n->from, refuse);
    }
    return true;
}

/*: rest needs reader */
/* How many bytes there are up to the last `behind` ones. */
static bool fk_rest(struct fk_in *n, int64_t behind, int64_t *size)
{
    *size = (int64_t)n->end - behind - (int64_t)n->at;
    if (*size < 0) {
        fk_note(n, FRAMEKIT_SHORT, n->at, -1);
        return false;
    }
    return true;
}

/*: find needs reader */
/* The place of some bytes from `at` on, before `end`. */
static bool fk_find(const uint8_t *data, size_t at, size_t end, const void *what, size_t size, size_t *place)
{
    for (; at + size <= end; at++) {
        if (memcmp(data + at, what, size) == 0) {
            *place = at;
            return true;
        }
    }
    return false;
}

/*: room needs spans */
static int64_t fk_room(const struct fk_span *span)
{
    return span->there ? (int64_t)(span->last - span->first) : 0;
}

/*: with_sign */
/* The number whose `bits` bits are these. */
static int64_t fk_with_sign(uint64_t value, unsigned bits)
{
    uint64_t sign = UINT64_C(1) << (bits - 1);
    if (value & sign) {
        return -(int64_t)(sign - (value & (sign - 1)) - 1) - 1;
    }
    return (int64_t)value;
}

/*: any_int */
/* A number of any size; 2 if it has more than 63 bits, and 8 bytes of it do not hold it. */
static int fk_any_int(const uint8_t *raw, int64_t size, bool little, bool is_signed, uint64_t *value)
{
    int64_t i;
    uint64_t found = 0;
    uint8_t fill = 0;
    if (size > 0 && is_signed && (raw[little ? size - 1 : 0] & 0x80) != 0) {
        fill = 0xFF;
        found = UINT64_MAX;
    }
    for (i = 0; i < size; i++) {
        if ((found >> 56) != fill) {
            return 2;
        }
        found = (found << 8) | raw[little ? size - 1 - i : i];
    }
    *value = found;
    return ((found >> 63) != 0) != (fill != 0) ? 2 : 0;
}

/*: digit */
static int fk_digit(uint8_t sign)
{
    if (sign >= '0' && sign <= '9') {
        return sign - '0';
    }
    if (sign >= 'A' && sign <= 'F') {
        return sign - 'A' + 10;
    }
    if (sign >= 'a' && sign <= 'f') {
        return sign - 'a' + 10;
    }
    return 99;
}

/*: digits needs digit */
/* A number in digits; 1 for what is none, 2 for one of more than 64 bits. */
static int fk_digits(const uint8_t *raw, int64_t size, int base, bool little, uint64_t *value)
{
    int64_t i;
    uint64_t found = 0;
    bool large = false;
    if (size <= 0 || (little && base == 16 && size % 2 != 0)) {
        return 1;
    }
    for (i = 0; i < size; i++) {
        int64_t place = !little ? i : base == 16 ? size - 2 - i + 2 * (i % 2) : size - 1 - i;
        int digit = fk_digit(raw[place]);
        if (digit >= base) {
            return 1;
        }
        if (found > (UINT64_MAX - (uint64_t)digit) / (uint64_t)base) {
            large = true;
            found = 0;
        }
        found = found * (uint64_t)base + (uint64_t)digit;
    }
    *value = found;
    return large ? 2 : 0;
}

/*: bcd */
static int fk_bcd(const uint8_t *raw, int64_t size, bool little, uint64_t *value)
{
    int64_t i;
    uint64_t found = 0;
    for (i = 0; i < size; i++) {
        uint8_t byte = raw[little ? size - 1 - i : i];
        if ((byte >> 4) > 9 || (byte & 15) > 9) {
            return 1;
        }
        if (found > (UINT64_MAX - 99) / 100) {
            return 2;
        }
        found = found * 100 + (uint64_t)(byte >> 4) * 10 + (byte & 15u);
    }
    *value = found;
    return 0;
}

/*: decimal_form */
/* How a number stands as text: digits behind the point (-1: any number), before it, of the exponent; what fills it up;
   what stands before one that is not negative (0: nothing); whether none is negative; whether a point stands alone. */
struct fk_decimal_form {
    int decimals, digits, exponent;
    uint8_t fill, plus;
    bool never_negative, point;
};

/*: decimal_text needs decimal_form */
/* Writes `figures` times 10 to the power of minus `places` as text of at most 256 characters; its size, -1 if none is
   the text of this number. `is_fixed`: the text has this size. */
static int64_t fk_decimal_text(bool is_negative, uint64_t figures, int64_t places, int64_t size, bool is_fixed,
                               const struct fk_decimal_form *form, uint8_t *to)
{
    uint8_t number[20], tail[8];
    int64_t count = 0, zeros, behind = form->decimals < 0 ? 0 : form->decimals, before, tail_size = 0, room, at = 0, i;
    int64_t power = -places, most = is_fixed ? size : 256;
    uint64_t left;
    if (power > 999 || power < -999 || most > 256 || most < 0 || (is_negative && form->never_negative)) {
        return -1;
    }
    for (left = figures; left != 0; left /= 10) {
        count++;
    }
    for (left = figures, i = count - 1; i >= 0; left /= 10, i--) {
        number[i] = (uint8_t)('0' + left % 10);
    }
    if (form->exponent > 0) {
        int64_t place = count > 0 ? count - 1 + power : 0, rest = place < 0 ? -place : place;
        tail_size = 2 + form->exponent;
        tail[0] = 'E';
        tail[1] = place < 0 ? '-' : '+';
        for (i = tail_size - 1; i > 1; i--, rest /= 10) {
            tail[i] = (uint8_t)('0' + rest % 10);
        }
        if (rest != 0) {
            return -1;
        }
        power = count > 1 ? 1 - count : 0;
    } else if (form->decimals < 0) {
        behind = power < 0 ? -power : 0;
    }
    for (zeros = power + behind; zeros < 0; zeros++) {
        if (count > 0 && number[--count] != '0') {
            return -1;
        }
    }
    before = count + zeros - behind;
    before = before < 0 ? 0 : before;
    before = before > form->digits ? before : form->digits;
    before = before == 0 && behind == 0 ? 1 : before;
    room = most - (is_negative || form->plus != 0) - before - (behind > 0 || form->point) - behind - tail_size;
    if (room < 0) {
        return -1;
    }
    room = is_fixed ? room : 0;
    for (i = 0; i < room && form->fill != '0'; i++) {
        to[at++] = form->fill;
    }
    if (is_negative || form->plus != 0) {
        to[at++] = is_negative ? '-' : form->plus;
    }
    for (; i < room; i++) {
        to[at++] = '0';
    }
    for (i = before + behind; i > 0; i--) { /* so many digits are left: zeros before the figures, and behind them */
        if (i == behind) {
            to[at++] = '.';
        }
        to[at++] = i > zeros && i <= zeros + count ? number[count + zeros - i] : '0';
    }
    if (behind == 0 && form->point) {
        to[at++] = '.';
    }
    memcpy(to + at, tail, (size_t)tail_size);
    return at + tail_size;
}

/*: decimal needs decimal_text */
/* The number that a text shows; 1 for what is none, or is written otherwise, 2 for one of more than 64 bits. */
static int fk_decimal(const uint8_t *raw, int64_t size, bool is_fixed, const struct fk_decimal_form *form,
                      int64_t *number, int64_t *places)
{
    uint8_t text[256];
    uint64_t figures = 0;
    int64_t at = 0, digits = 0, exponent = 0, built;
    bool is_negative = false, has_point = false;
    *number = *places = 0;
    if (size > 256) {
        return 1;
    }
    while (is_fixed && form->fill != '0' && at < size && raw[at] == form->fill) {
        at++;
    }
    at += form->plus == ' ' && at < size && raw[at] == ' ';
    if (at < size && (raw[at] == '+' || raw[at] == '-')) {
        is_negative = raw[at++] == '-';
    }
    for (; at < size && ((raw[at] >= '0' && raw[at] <= '9') || (raw[at] == '.' && !has_point)); at++) {
        if (raw[at] == '.') {
            has_point = true;
            continue;
        }
        digits++;
        *places += has_point;
        if (figures > (uint64_t)(INT64_MAX - 9) / 10) {
            return 2;
        }
        figures = figures * 10 + (uint64_t)(raw[at] - '0');
    }
    if (digits > 0 && at + 2 < size && raw[at] == 'E' && (raw[at + 1] == '+' || raw[at + 1] == '-')) {
        bool is_small = raw[at + 1] == '-';
        for (at += 2; at < size && raw[at] >= '0' && raw[at] <= '9' && exponent < 10000; at++) {
            exponent = exponent * 10 + (raw[at] - '0');
        }
        *places += is_small ? exponent : -exponent;
    }
    if (digits == 0 || at < size) {
        return 1;
    }
    if (form->decimals == 0 && form->exponent == 0 && !form->point) {
        is_negative = is_negative && figures != 0;
    }
    built = fk_decimal_text(is_negative, figures, *places, size, is_fixed, form, text);
    if (built != size || memcmp(text, raw, (size_t)size) != 0) {
        return 1;
    }
    *number = is_negative ? -(int64_t)figures : (int64_t)figures;
    return 0;
}

/*: decimal_number needs decimal */
static int fk_decimal_number(const uint8_t *raw, int64_t size, bool is_fixed, const struct fk_decimal_form *form,
                             uint64_t *value)
{
    int64_t number, places;
    int found = fk_decimal(raw, size, is_fixed, form, &number, &places);
    *value = (uint64_t)number;
    return found;
}

/*: decimal_value needs decimal */
static int fk_decimal_value(const uint8_t *raw, int64_t size, bool is_fixed, const struct fk_decimal_form *form,
                            struct framekit_decimal *value)
{
    int64_t number, places;
    int found = fk_decimal(raw, size, is_fixed, form, &number, &places);
    value->number = found == 0 ? number : 0;
    value->places = (int16_t)(found == 0 ? places : 0);
    return found;
}

/*: unhex needs digit */
/* Two digits a byte; nothing is written for an odd number of them, or what is none. */
static bool fk_unhex(const uint8_t *digits, size_t size, uint8_t *to)
{
    size_t i;
    if (size % 2 != 0) {
        return false;
    }
    for (i = 0; i < size; i += 2) {
        int high = fk_digit(digits[i]), low = fk_digit(digits[i + 1]);
        if (high > 15 || low > 15) {
            return false;
        }
        to[i / 2] = (uint8_t)(high * 16 + low);
    }
    return true;
}

/*: hex */
/* Two capital digits for each byte. */
static void fk_hex(const uint8_t *data, size_t size, uint8_t *to)
{
    size_t i;
    for (i = 0; i < size; i++) {
        to[2 * i] = (uint8_t)"0123456789ABCDEF"[data[i] >> 4];
        to[2 * i + 1] = (uint8_t)"0123456789ABCDEF"[data[i] & 15];
    }
}

/*: swap */
/* The bytes of every unit turned round; what fills no unit stays. */
static void fk_swap(uint8_t *data, size_t size, size_t unit)
{
    size_t i, k;
    for (i = 0; i + unit <= size; i += unit) {
        for (k = 0; k < unit / 2; k++) {
            uint8_t kept = data[i + k];
            data[i + k] = data[i + unit - 1 - k];
            data[i + unit - 1 - k] = kept;
        }
    }
}

/*: float */
static float fk_float(uint32_t bits)
{
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/*: double */
static double fk_double(uint64_t bits)
{
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/*: float_bits */
static uint32_t fk_float_bits(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/*: double_bits */
static uint64_t fk_double_bits(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/*: view */
static struct framekit_bytes fk_view(const uint8_t *data, size_t size)
{
    struct framekit_bytes view;
    view.data = data;
    view.size = size;
    return view;
}

/*: bad */
static int64_t fk_bad(bool *bad)
{
    *bad = true;
    return 0;
}

/*: bad_bytes needs view */
static struct framekit_bytes fk_bad_bytes(bool *bad)
{
    *bad = true;
    return fk_view(NULL, 0);
}

/*: same_bytes */
static bool fk_same_bytes(struct framekit_bytes one, struct framekit_bytes other)
{
    return one.size == other.size && (one.size == 0 || memcmp(one.data, other.data, one.size) == 0);
}

/*: same_letters */
/* Whether texts are equal but for capitals; one of them has none, or nothing else. */
static bool fk_same_letters(struct framekit_bytes one, struct framekit_bytes other)
{
    size_t i;
    if (one.size != other.size) {
        return false;
    }
    for (i = 0; i < one.size; i++) {
        uint8_t a = one.data[i], b = other.data[i];
        if (a != b && !((a ^ b) == 0x20 && (a | 0x20) >= 'a' && (a | 0x20) <= 'z')) {
            return false;
        }
    }
    return true;
}

/*: holds */
static bool fk_holds(struct framekit_bytes in, struct framekit_bytes what)
{
    size_t i;
    if (what.size == 0) {
        return true;
    }
    for (i = 0; i + what.size <= in.size; i++) {
        if (memcmp(in.data + i, what.data, what.size) == 0) {
            return true;
        }
    }
    return false;
}

/*: only */
static bool fk_only(struct framekit_bytes text, struct framekit_bytes letters)
{
    size_t first = 0, i, k;
    for (i = 0; i < text.size; i++) {
        for (k = 0; k < letters.size && letters.data[k] != text.data[i]; k++) {
        }
        if (k == letters.size) {
            first++;
        }
    }
    return first == 0;
}

/*: part needs view */
static struct framekit_bytes fk_part(struct framekit_bytes of, int64_t first, int64_t last)
{
    int64_t size = (int64_t)of.size;
    first = first < 0 ? (first + size < 0 ? 0 : first + size) : first > size ? size : first;
    last = last < 0 ? (last + size < 0 ? 0 : last + size) : last > size ? size : last;
    if (last <= first) {
        return fk_view(NULL, 0);
    }
    return fk_view(of.data + first, (size_t)(last - first));
}

/*: letter_at needs view bad_bytes */
static struct framekit_bytes fk_letter_at(struct framekit_bytes of, int64_t place, bool *bad)
{
    int64_t size = (int64_t)of.size;
    if (place < 0) {
        place += size;
    }
    if (place < 0 || place >= size) {
        return fk_bad_bytes(bad);
    }
    return fk_view(of.data + place, 1);
}

/*: text_number needs bad */
static int64_t fk_text_number(struct framekit_bytes text, int base, int64_t most, bool *bad)
{
    int64_t value = 0;
    size_t i;
    if (text.size == 0) {
        return fk_bad(bad);
    }
    for (i = 0; i < text.size; i++) {
        uint8_t sign = text.data[i];
        int digit = 99;
        if (sign >= '0' && sign <= '9') {
            digit = sign - '0';
        } else if ((sign | 0x20) >= 'a' && (sign | 0x20) <= 'z') {
            digit = (sign | 0x20) - 'a' + 10;
        }
        if (digit >= base || value > (most - digit) / base) {
            return fk_bad(bad);
        }
        value = value * base + digit;
    }
    return value;
}

/*: divided needs bad */
static int64_t fk_divided(int64_t one, int64_t by, bool *bad)
{
    if (by == 0) {
        return fk_bad(bad);
    }
    return one >= 0 ? one / by : -((-(one + 1)) / by) - 1;
}

/*: remainder needs bad */
static int64_t fk_remainder(int64_t one, int64_t by, bool *bad)
{
    int64_t found;
    if (by == 0) {
        return fk_bad(bad);
    }
    found = one % by;
    return found < 0 ? found + by : found;
}

/*: least */
static int64_t fk_least(int64_t one, int64_t other)
{
    return one < other ? one : other;
}

/*: greatest */
static int64_t fk_greatest(int64_t one, int64_t other)
{
    return one > other ? one : other;
}

/*: absolute */
static int64_t fk_absolute(int64_t value)
{
    return value < 0 ? -value : value;
}

/*: rotated */
static int64_t fk_rotated(int64_t value, int64_t count)
{
    uint64_t byte = (uint64_t)value & 0xFF;
    unsigned by = (unsigned)((uint64_t)count & 7);
    return (int64_t)((byte << by | byte >> (8 - by)) & 0xFF);
}

/*: reflected */
/* The bits in reverse order. */
static uint64_t fk_reflected(uint64_t value, unsigned width)
{
    uint64_t found = 0;
    unsigned i;
    for (i = 0; i < width; i++) {
        found = found << 1 | (value >> i & 1);
    }
    return found;
}

/*: same_digits */
/* Whether digits are the same but for capitals. */
static bool fk_same_digits(const uint8_t *one, const uint8_t *other, size_t size)
{
    size_t i;
    for (i = 0; i < size; i++) {
        uint8_t a = one[i], b = other[i];
        a = a >= 'a' && a <= 'z' ? (uint8_t)(a - 32) : a;
        b = b >= 'a' && b <= 'z' ? (uint8_t)(b - 32) : b;
        if (a != b) {
            return false;
        }
    }
    return true;
}

/*: put_int */
static void fk_put_int(uint8_t *to, uint64_t value, int64_t size, bool little)
{
    int64_t i;
    for (i = 0; i < size; i++) {
        to[little ? i : size - 1 - i] = (uint8_t)(i < 8 ? value >> (8 * i) & 0xFF : 0);
    }
}

/*: put_signed */
static void fk_put_signed(uint8_t *to, int64_t value, int64_t size, bool little)
{
    int64_t i;
    for (i = 0; i < size; i++) {
        to[little ? i : size - 1 - i] = (uint8_t)(i < 8 ? (uint64_t)value >> (8 * i) & 0xFF : value < 0 ? 0xFF : 0);
    }
}

/*: put_places */
static void fk_put_places(uint8_t *to, uint64_t value, int64_t size, const uint8_t *places)
{
    int64_t i;
    for (i = 0; i < size; i++) {
        to[places[i]] = (uint8_t)(value >> (8 * (size - 1 - i)) & 0xFF);
    }
}

/*: put_digits */
static void fk_put_digits(uint8_t *to, uint64_t value, int64_t size, int base, bool little, bool upper)
{
    int64_t i;
    for (i = 0; i < size; i++) {
        unsigned digit = (unsigned)(value % (uint64_t)base);
        int64_t place = !little ? size - 1 - i : base == 16 ? i + 1 - 2 * (i % 2) : i;
        value /= (uint64_t)base;
        if (place < size) {
            to[place] = (uint8_t)(upper ? "0123456789ABCDEF" : "0123456789abcdef")[digit];
        }
    }
}

/*: put_bcd */
static void fk_put_bcd(uint8_t *to, uint64_t value, int64_t size, bool little)
{
    int64_t i;
    for (i = 0; i < size; i++) {
        unsigned pair = (unsigned)(value % 100);
        value /= 100;
        to[little ? i : size - 1 - i] = (uint8_t)(pair / 10 * 16 + pair % 10);
    }
}

/*: put_nibbles */
static void fk_put_nibbles(uint8_t *to, uint64_t value, int64_t size, bool little)
{
    int64_t i;
    for (i = 0; i + 1 < size; i += 2) {
        unsigned byte = (unsigned)(value >> (8 * (little ? i / 2 : size / 2 - 1 - i / 2)) & 0xFF);
        to[i] = (uint8_t)(0x30 + (byte >> 4));
        to[i + 1] = (uint8_t)(0x30 + (byte & 15));
    }
}

/*: map_same needs reader */
static size_t fk_map_same(const struct fk_in *n, size_t place)
{
    (void)n;
    return place;
}

/*: map_hex needs reader */
static size_t fk_map_hex(const struct fk_in *n, size_t place)
{
    (void)n;
    return 2 * place;
}

/*: map_short needs reader */
static size_t fk_map_short(const struct fk_in *n, size_t place)
{
    return place < n->raw_size ? place : n->raw_size;
}

/*: find_stop needs reader */
/* The first place of one of some pieces; none that begins behind an earlier one counts. */
static bool fk_find_stop(const uint8_t *data, size_t at, size_t end, const struct fk_stop *stops, size_t count,
                         size_t longest, size_t *place)
{
    size_t i;
    (void)longest;
    for (; at < end; at++) {
        for (i = 0; i < count; i++) {
            if (at + stops[i].size <= end && memcmp(data + at, stops[i].data, stops[i].size) == 0) {
                *place = at;
                return true;
            }
        }
    }
    return false;
}

/*: before */
/* How many bytes of a text stand before some bytes. */
static size_t fk_before(struct framekit_bytes text, const void *what, size_t size)
{
    size_t at;
    for (at = 0; at + size <= text.size; at++) {
        if (memcmp(text.data + at, what, size) == 0) {
            return at;
        }
    }
    return text.size;
}

/*: end_of_region needs reader */
/* The place of the first escape byte that is not doubled, and with which nothing begins that is embedded. */
static bool fk_end_of_region(const uint8_t *data, size_t at, size_t end, uint8_t escape,
                             const struct fk_stop *embedded, size_t count, size_t *place)
{
    size_t i;
    while (at + 1 < end) {
        if (data[at] != escape) {
            at++;
        } else if (data[at + 1] == escape) {
            at += 2;
        } else {
            for (i = 0; i < count && (uint8_t)embedded[i].data[1] != data[at + 1]; i++) {
            }
            if (i == count) {
                *place = at;
                return true;
            }
            at += embedded[i].size;
        }
    }
    return false;
}

/*: embedded_at needs reader */
/* The size of what is embedded here; 0 for nothing. */
static size_t fk_embedded_at(const uint8_t *raw, size_t size, size_t at, const struct fk_stop *embedded, size_t count)
{
    size_t i;
    for (i = 0; i < count; i++) {
        if (at + embedded[i].size <= size && memcmp(raw + at, embedded[i].data, embedded[i].size) == 0) {
            return embedded[i].size;
        }
    }
    return 0;
}

/*: end_of_stuffed */
/* The place behind so many bytes of content; 1 if there are fewer, 2 where the escape byte is not doubled. */
static int fk_end_of_stuffed(const uint8_t *data, size_t at, size_t end, uint8_t escape, size_t size, size_t *place)
{
    for (; size > 0; size--) {
        if (at >= end) {
            return 1;
        }
        if (data[at] == escape) {
            at++;
            if (at >= end) {
                return 1;
            }
            if (data[at] != escape) {
                return 2;
            }
        }
        at++;
    }
    *place = at;
    return 0;
}

/*: map_escaped needs reader embedded_at */
static size_t fk_map_escaped(const struct fk_in *n, size_t place)
{
    size_t at = 0, size;
    for (;;) {
        size = fk_embedded_at(n->raw, n->raw_size, at, n->how->embedded, n->how->embedded_count);
        if (size == 0) {
            if (place == 0 || at >= n->raw_size) {
                return at < n->raw_size ? at : n->raw_size;
            }
            size = n->raw[at] == n->how->escape ? 2 : 1;
            place--;
        }
        at += size;
    }
}

/*: map_cobs needs reader */
static size_t fk_map_cobs(const struct fk_in *n, size_t place)
{
    size_t at = 0, seen = 0, size;
    if (place == 0) {
        return n->raw_size > 1 ? 0 : n->raw_size;
    }
    while (at < n->raw_size) {
        size = n->raw[at];
        if (size == 0) {
            return at;
        }
        if (place < seen + size - 1) {
            return at + 1 + place - seen;
        }
        seen += size - 1;
        at += size;
        if (size < 255 && at < n->raw_size) {
            if (place == seen) {
                return at;
            }
            seen++;
        }
    }
    return n->raw_size;
}

/*: map_inserted needs reader */
static size_t fk_map_inserted(const struct fk_in *n, size_t place)
{
    size_t at = 0, run = 0;
    for (;;) {
        if (run >= n->how->after_size && memcmp(n->raw + at - n->how->after_size, n->how->after, n->how->after_size) == 0) {
            at += n->how->insert_size;
            run = 0;
        }
        if (place == 0 || at >= n->raw_size) {
            return at < n->raw_size ? at : n->raw_size;
        }
        place--;
        at++;
        run++;
    }
}

/*: map_blocks needs reader */
static size_t fk_map_blocks(const struct fk_in *n, size_t place)
{
    size_t at = place + place / n->how->block * n->how->width;
    return at < n->raw_size ? at : n->raw_size;
}

/*: open_hex needs digit */
static enum framekit_reason fk_open_hex(const uint8_t *raw, size_t size, uint8_t *to, size_t room, size_t *got, size_t *bad)
{
    size_t i;
    *got = 0;
    for (i = 0; i < size; i += 2) {
        int high, low;
        if (i + 1 >= size || (high = fk_digit(raw[i])) > 15 || (low = fk_digit(raw[i + 1])) > 15) {
            *got = 0;
            *bad = i;
            return FRAMEKIT_DIGITS;
        }
        if (*got >= room) {
            return FRAMEKIT_NO_ROOM;
        }
        to[(*got)++] = (uint8_t)(high * 16 + low);
    }
    return FRAMEKIT_OK;
}

/*: open_doubled needs embedded_at */
static enum framekit_reason fk_open_doubled(const uint8_t *raw, size_t size, uint8_t escape,
                                            const struct fk_stop *embedded, size_t count, uint8_t *to, size_t room,
                                            size_t *got, size_t *bad)
{
    size_t i, skipped;
    *got = 0;
    for (i = 0; i < size; i++) {
        skipped = fk_embedded_at(raw, size, i, embedded, count);
        if (skipped > 0) {
            i += skipped - 1;
            continue;
        }
        if (*got >= room) {
            return FRAMEKIT_NO_ROOM;
        }
        to[(*got)++] = raw[i];
        if (raw[i] == escape) {
            i++;
            if (i >= size || raw[i] != escape) {
                *got = 0;
                *bad = i - 1;
                return FRAMEKIT_CONSTANT;
            }
        }
    }
    return FRAMEKIT_OK;
}

/*: open_cobs */
static enum framekit_reason fk_open_cobs(const uint8_t *raw, size_t size, uint8_t *to, size_t room, size_t *got, size_t *bad)
{
    size_t at = 0, i;
    *got = 0;
    *bad = 0;
    while (at < size) {
        size_t group = raw[at];
        for (i = 1; i < group && at + i < size && raw[at + i] != 0; i++) {
        }
        if (group == 0 || i < group) {
            *got = 0;
            *bad = at;
            return FRAMEKIT_CONSTANT;
        }
        if (*got + group > room) {
            return FRAMEKIT_NO_ROOM;
        }
        memcpy(to + *got, raw + at + 1, group - 1);
        *got += group - 1;
        at += group;
        if (group < 255 && at < size) {
            to[(*got)++] = 0;
        }
    }
    return size == 0 ? FRAMEKIT_CONSTANT : FRAMEKIT_OK;
}

/*: open_inserted */
static enum framekit_reason fk_open_inserted(const uint8_t *raw, size_t size, const void *after, size_t after_size,
                                             const void *insert, size_t insert_size, uint8_t *to, size_t room,
                                             size_t *got, size_t *bad)
{
    size_t at = 0, run = 0;
    *got = 0;
    while (at < size) {
        if (*got >= room) {
            return FRAMEKIT_NO_ROOM;
        }
        to[(*got)++] = raw[at++];
        run++;
        if (run >= after_size && memcmp(raw + at - after_size, after, after_size) == 0) {
            if (at + insert_size > size || memcmp(raw + at, insert, insert_size) != 0) {
                *got = 0;
                *bad = at - after_size;
                return FRAMEKIT_CONSTANT;
            }
            at += insert_size;
            run = 0;
        }
    }
    return FRAMEKIT_OK;
}

/*: open_short */
static enum framekit_reason fk_open_short(const uint8_t *raw, size_t size, uint8_t fill, size_t least, size_t whole,
                                          uint8_t *to, size_t *got, size_t *bad)
{
    *got = 0;
    if (size < least) {
        *bad = size;
        return FRAMEKIT_SHORT;
    }
    if (size > whole) {
        *bad = whole;
        return FRAMEKIT_TOO_LONG;
    }
    memcpy(to, raw, size);
    memset(to + size, fill, whole - size);
    *got = whole;
    return FRAMEKIT_OK;
}

/*: told needs reader */
/* What is told of a frame: a wrong check code before everything else, and it is refused only if that is right. */
static void fk_told(const struct fk_notes *notes, struct framekit_fault *fault)
{
    fault->refuse = -1;
    if (notes->no_room) {
        fault->reason = FRAMEKIT_NO_ROOM;
        fault->offset = 0;
    } else if (notes->wrong_check) {
        fault->reason = FRAMEKIT_CHECK;
        fault->offset = notes->check_place;
    } else {
        fault->reason = notes->reason;
        fault->offset = notes->place;
        if (notes->reason != FRAMEKIT_OK && !notes->unchecked) {
            fault->refuse = notes->refuse;
        }
    }
}

/*: writer needs spans */
/* Bytes that are put together: how many there are so far, and why the values cannot be sent. */
struct fk_out {
    uint8_t *data;
    size_t room, at;
    enum framekit_reason reason;
};

/*: fail needs writer */
static void fk_fail(struct fk_out *w, enum framekit_reason reason)
{
    if (w->reason == FRAMEKIT_OK) {
        w->reason = reason;
    }
}

/*: put needs writer fail */
/* Room for so many bytes; NULL if there is none. */
static uint8_t *fk_put(struct fk_out *w, int64_t size)
{
    uint8_t *found;
    if (size < 0 || (uint64_t)size > w->room - w->at) {
        fk_fail(w, size < 0 ? FRAMEKIT_LENGTH : FRAMEKIT_NO_ROOM);
        return NULL;
    }
    found = w->data + w->at;
    w->at += (size_t)size;
    return found;
}

/*: put_bytes needs put */
static void fk_put_bytes(struct fk_out *w, const void *data, size_t size)
{
    uint8_t *to = fk_put(w, (int64_t)size);
    if (to != NULL && size > 0) {
        memcpy(to, data, size);
    }
}

/*: put_fill needs put */
/* Bytes repeated up to a size. */
static void fk_put_fill(struct fk_out *w, const char *fill, size_t each, int64_t size)
{
    uint8_t *to = fk_put(w, size);
    int64_t i;
    for (i = 0; to != NULL && i < size; i++) {
        to[i] = (uint8_t)fill[(size_t)i % each];
    }
}

/*: put_decimal needs put decimal_text */
static void fk_put_decimal(struct fk_out *w, int64_t number, int64_t places, int64_t size, bool is_fixed,
                           const struct fk_decimal_form *form)
{
    uint8_t text[256], *to;
    uint64_t figures = number < 0 ? (uint64_t)(-(number + 1)) + 1 : (uint64_t)number;
    int64_t built = fk_decimal_text(number < 0, figures, places, size, is_fixed, form, text);
    if (built < 0) {
        fk_fail(w, FRAMEKIT_RANGE);
        return;
    }
    to = fk_put(w, built);
    if (to != NULL) {
        memcpy(to, text, (size_t)built);
    }
}

/*: put_hex_bytes needs put hex */
static void fk_put_hex_bytes(struct fk_out *w, const uint8_t *data, size_t size)
{
    uint8_t *to = fk_put(w, 2 * (int64_t)size);
    if (to != NULL) {
        fk_hex(data, size, to);
    }
}

/*: put_unhex_bytes needs put unhex */
static void fk_put_unhex_bytes(struct fk_out *w, const uint8_t *digits, size_t size)
{
    uint8_t *to = fk_put(w, (int64_t)(size / 2));
    if (to != NULL && !fk_unhex(digits, size, to)) {
        fk_fail(w, FRAMEKIT_DIGITS);
    }
}

/*: holds_end */
/* Whether bytes, with those that end them behind, hold these earlier. */
static bool fk_holds_end(const uint8_t *data, size_t first, size_t last, const char *end, size_t size)
{
    size_t i, k;
    for (i = first; i < last; i++) {
        for (k = 0; k < size && (i + k < last ? data[i + k] : (uint8_t)end[i + k - last]) == (uint8_t)end[k]; k++) {
        }
        if (k == size) {
            return true;
        }
    }
    return false;
}

/*: starts_stop needs find_stop */
static bool fk_starts_stop(const uint8_t *data, size_t at, size_t end, const struct fk_stop *stops, size_t count)
{
    size_t i;
    for (i = 0; i < count; i++) {
        if (at + stops[i].size <= end && memcmp(data + at, stops[i].data, stops[i].size) == 0) {
            return true;
        }
    }
    return false;
}

/*: holds_byte */
static bool fk_holds_byte(struct framekit_bytes data, const char *bytes, size_t count)
{
    size_t i, k;
    for (i = 0; i < data.size; i++) {
        for (k = 0; k < count; k++) {
            if (data.data[i] == (uint8_t)bytes[k]) {
                return true;
            }
        }
    }
    return false;
}

/*: wrap_hex needs put hex */
static void fk_wrap_hex(struct fk_out *w, const uint8_t *plain, size_t size)
{
    uint8_t *to = fk_put(w, 2 * (int64_t)size);
    if (to != NULL) {
        fk_hex(plain, size, to);
    }
}

/*: wrap_doubled needs put_bytes */
static void fk_wrap_doubled(struct fk_out *w, const uint8_t *plain, size_t size, uint8_t escape)
{
    size_t i;
    for (i = 0; i < size; i++) {
        fk_put_bytes(w, plain + i, 1);
        if (plain[i] == escape) {
            fk_put_bytes(w, plain + i, 1);
        }
    }
}

/*: wrap_cobs needs put */
static void fk_wrap_cobs(struct fk_out *w, const uint8_t *plain, size_t size)
{
    size_t at = 0, group;
    uint8_t *to;
    bool more = true;
    while (more) {
        for (group = 0; group < 254 && at + group < size && plain[at + group] != 0; group++) {
        }
        to = fk_put(w, 1 + (int64_t)group);
        if (to != NULL) {
            to[0] = (uint8_t)(group + 1);
            memcpy(to + 1, plain + at, group);
        }
        at += group;
        more = at < size;
        if (more && group < 254) {
            at++;
        }
    }
}

/*: wrap_inserted needs put_bytes */
static void fk_wrap_inserted(struct fk_out *w, const uint8_t *plain, size_t size, const void *after, size_t after_size,
                             const void *insert, size_t insert_size)
{
    size_t i, run = 0;
    for (i = 0; i < size; i++) {
        fk_put_bytes(w, plain + i, 1);
        run++;
        if (run >= after_size && memcmp(plain + i + 1 - after_size, after, after_size) == 0) {
            fk_put_bytes(w, insert, insert_size);
            run = 0;
        }
    }
}

/*: wrap_short needs put_bytes */
static void fk_wrap_short(struct fk_out *w, const uint8_t *plain, size_t size, uint8_t fill, size_t least)
{
    while (size > least && plain[size - 1] == fill) {
        size--;
    }
    fk_put_bytes(w, plain, size);
}

/*: fits */
/* Whether a number fits into so many bytes (base 256) or digits. */
static bool fk_fits(int64_t value, int64_t size, int base, bool is_signed)
{
    uint64_t left = (uint64_t)value;
    if (is_signed) {
        uint64_t limit;
        if (size <= 0) {
            return false;
        }
        if (size >= 8) {
            return true;
        }
        limit = UINT64_C(1) << (8 * size - 1);
        return value >= 0 ? left < limit : (uint64_t)(-(value + 1)) < limit;
    }
    if (value < 0) {
        return false;
    }
    for (; size > 0 && left != 0; size--) {
        left /= (uint64_t)base;
    }
    return left == 0 && (size > 0 || base == 256 || value != 0);
}

/*: same_items */
/* Whether texts are all equal, each so many bytes behind the one before. */
static bool fk_same_items(const struct framekit_bytes *first, size_t count, size_t step)
{
    size_t i;
    for (i = 1; i < count; i++) {
        const struct framekit_bytes *one = (const void *)((const char *)first + i * step);
        if (one->size != first->size || (one->size > 0 && memcmp(one->data, first->data, one->size) != 0)) {
            return false;
        }
    }
    return true;
}

/*: is_upper */
/* Whether a text has no small letters. */
static bool fk_is_upper(struct framekit_bytes text)
{
    size_t i;
    for (i = 0; i < text.size; i++) {
        uint8_t sign = text.data[i];
        if ((sign >= 'a' && sign <= 'z') || sign == 0xB5 || (sign >= 0xDF && sign != 0xF7)) {
            return false;
        }
    }
    return true;
}

/*: is_lower */
/* Whether a text has no capital letters. */
static bool fk_is_lower(struct framekit_bytes text)
{
    size_t i;
    for (i = 0; i < text.size; i++) {
        uint8_t sign = text.data[i];
        if ((sign >= 'A' && sign <= 'Z') || (sign >= 0xC0 && sign <= 0xDE && sign != 0xD7)) {
            return false;
        }
    }
    return true;
}

/*: folded needs view */
/* A text in capital or small letters; the few that have no such letter in one byte do not fit. */
static struct framekit_bytes fk_folded(struct framekit_bytes text, bool upper, uint8_t *to, size_t room, bool *no_room)
{
    size_t i;
    if (text.size > room) {
        *no_room = true;
        return fk_view(to, 0);
    }
    for (i = 0; i < text.size; i++) {
        uint8_t sign = text.data[i];
        if (upper && ((sign >= 'a' && sign <= 'z') || (sign >= 0xE0 && sign != 0xF7 && sign != 0xFF))) {
            sign = (uint8_t)(sign - 32);
        } else if (upper && (sign == 0xB5 || sign == 0xDF || sign == 0xFF)) {
            *no_room = true;
        } else if (!upper && ((sign >= 'A' && sign <= 'Z') || (sign >= 0xC0 && sign <= 0xDE && sign != 0xD7))) {
            sign = (uint8_t)(sign + 32);
        }
        to[i] = sign;
    }
    return fk_view(to, text.size);
}

/*: byte_at needs bad */
static int64_t fk_byte_at(struct framekit_bytes of, int64_t place, bool *bad)
{
    int64_t size = (int64_t)of.size;
    if (place < 0) {
        place += size;
    }
    return place < 0 || place >= size ? fk_bad(bad) : of.data[place];
}
