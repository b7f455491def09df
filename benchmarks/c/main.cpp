/* Measures generated C, C by hand and Kaitai's C++ with the same bytes: `benchmarks/rows/generated_c.py` starts it.

A line in is `WHAT REGISTERS COUNT`; the line out is the processor time in seconds of doing that so many times, with a
reply of so many registers. What each side finds is compared with what the generated C was given, once for each size. */
#include "by_hand.h"
#include "registers.h"
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>
#ifdef WITH_KAITAI
#include "kaitai/kaitaistream.h"
#include "modbus_reply.h"
#endif

static const size_t FRAMES = 1000; /* replies of a stream */
static const size_t PIECE = 64;    /* bytes of it that come at once */

static registers_reply_adu given;
static hand_reply given_by_hand;
static std::string one, many;

static void must(bool holds, const char *what)
{
    if (!holds) {
        std::fprintf(stderr, "%s: not the same\n", what);
        std::exit(1);
    }
}

static const uint8_t *bytes(const std::string &text)
{
    return reinterpret_cast<const uint8_t *>(text.data());
}

static bool same(size_t count, const uint16_t *values)
{
    const auto &wanted = given.pdu.of.read_holding_reply.values;
    return count == wanted.count && values[0] == wanted.items[0] && values[count - 1] == wanted.items[count - 1];
}

/* ---- one frame: whether it was read, or how long it is ---- */

static void decode_generated()
{
    static registers_reply_adu reply;
    framekit_fault fault;
    bool good = registers_decode_reply_adu(bytes(one), one.size(), &reply, &fault) == FRAMEKIT_OK;
    const auto &values = reply.pdu.of.read_holding_reply.values;
    must(good && same(values.count, values.items), "decode");
}

static void decode_by_hand()
{
    static hand_reply reply;
    bool good = hand_decode(bytes(one), one.size(), &reply);
    must(good && same(reply.count, reply.values), "decode by hand");
}

static void encode_generated()
{
    uint8_t to[256];
    int32_t size = registers_encode_reply_adu(&given, to, sizeof to);
    must(size == static_cast<int32_t>(one.size()) && to[size - 1] == bytes(one)[size - 1], "encode");
}

static void encode_by_hand()
{
    uint8_t to[256];
    size_t size = hand_encode(&given_by_hand, to, sizeof to);
    must(size == one.size() && to[size - 1] == bytes(one)[size - 1], "encode by hand");
}

/* ---- a stream of frames ---- */

static void stream_generated()
{
    static registers_parser parser;
    size_t found = 0, at = 0, piece;
    framekit_event event;
    registers_parser_begin(&parser, FRAMEKIT_FROM_SERVER);
    while (at < many.size()) {
        piece = many.size() - at < PIECE ? many.size() - at : PIECE;
        at += registers_parser_put(&parser, bytes(many) + at, piece);
        while ((event = registers_parser_next(&parser)) != FRAMEKIT_MORE) {
            const auto &values = parser.of.reply_adu.pdu.of.read_holding_reply.values;
            found += event == FRAMEKIT_FRAME && same(values.count, values.items);
        }
    }
    must(found == FRAMES, "stream");
}

static void stream_by_hand()
{
    static hand_parser parser;
    static hand_reply reply;
    size_t found = 0, at = 0, piece;
    std::memset(&parser, 0, sizeof parser);
    while (at < many.size()) {
        piece = many.size() - at < PIECE ? many.size() - at : PIECE;
        at += hand_put(&parser, bytes(many) + at, piece);
        while (hand_next(&parser, &reply)) {
            found += same(reply.count, reply.values);
        }
    }
    must(found == FRAMES, "stream by hand");
}

#ifdef WITH_KAITAI
static bool is_good(const modbus_reply_t &reply, const uint8_t *data, size_t size)
{
    const auto *pdu = dynamic_cast<modbus_reply_t::registers_t *>(reply.pdu());
    return pdu != nullptr && reply.check() == hand_crc(data, size - 2) &&
           same(pdu->values()->size(), pdu->values()->data());
}

static void decode_kaitai()
{
    kaitai::kstream in(one);
    modbus_reply_t reply(&in);
    must(is_good(reply, bytes(one), one.size()), "decode by Kaitai");
}

/* All bytes at once: Kaitai waits for none. */
static void stream_kaitai()
{
    kaitai::kstream in(many);
    size_t found = 0, at = 0;
    while (at < many.size()) {
        modbus_reply_t reply(&in);
        size_t end = static_cast<size_t>(in.pos());
        found += is_good(reply, bytes(many) + at, end - at);
        at = end;
    }
    must(found == FRAMES, "stream by Kaitai");
}
#endif

static const struct {
    const char *name;
    void (*work)();
} WORK[] = {
    { "decode_generated", decode_generated }, { "decode_by_hand", decode_by_hand },
    { "encode_generated", encode_generated }, { "encode_by_hand", encode_by_hand },
    { "stream_generated", stream_generated }, { "stream_by_hand", stream_by_hand },
#ifdef WITH_KAITAI
    { "decode_kaitai", decode_kaitai }, { "stream_kaitai", stream_kaitai },
#endif
};

/* A reply of so many registers, and a stream of such. */
static void make(size_t registers)
{
    uint8_t to[256];
    auto &reply = given.pdu.of.read_holding_reply;
    given.station = given_by_hand.station = 17;
    given_by_hand.function = 3;
    given.pdu.frame = REGISTERS_FRAME_read_holding_reply;
    reply.values.count = registers;
    given_by_hand.count = static_cast<uint8_t>(registers);
    for (size_t i = 0; i < registers; i++) {
        reply.values.items[i] = given_by_hand.values[i] = static_cast<uint16_t>(1000 + 37 * i);
    }
    int32_t size = registers_encode_reply_adu(&given, to, sizeof to);
    must(size > 0, "encode");
    one.assign(reinterpret_cast<const char *>(to), static_cast<size_t>(size));
    must(hand_encode(&given_by_hand, to, sizeof to) == one.size() && std::memcmp(to, one.data(), one.size()) == 0,
         "encode by hand");
    many.clear();
    for (size_t i = 0; i < FRAMES; i++) {
        many += one;
    }
}

int main()
{
    char name[64];
    size_t registers, count, made = 0;
    while (std::scanf("%63s %zu %zu", name, &registers, &count) == 3) {
        if (registers != made) {
            make(registers);
            made = registers;
        }
        for (const auto &work : WORK) {
            if (std::strcmp(work.name, name) == 0) {
                std::clock_t begin = std::clock();
                for (size_t i = 0; i < count; i++) {
                    work.work();
                }
                std::printf("%.9f\n", static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC);
                std::fflush(stdout);
            }
        }
    }
    return 0;
}
