/* The register reply of Modbus RTU by hand; the check code is worked out as generated C does it, by a table. */
#include "by_hand.h"
#include <string.h>

uint16_t hand_crc(const uint8_t *data, size_t size)
{
    static uint16_t table[256];
    uint16_t code = 0xFFFF;
    size_t i;
    if (table[1] == 0) {
        for (i = 0; i < 256; i++) {
            uint16_t entry = (uint16_t)i;
            int bit;
            for (bit = 0; bit < 8; bit++) {
                entry = (uint16_t)(entry & 1 ? entry >> 1 ^ 0xA001 : entry >> 1);
            }
            table[i] = entry;
        }
    }
    for (i = 0; i < size; i++) {
        code = (uint16_t)(code >> 8 ^ table[(code ^ data[i]) & 0xFF]);
    }
    return code;
}

bool hand_decode(const uint8_t *data, size_t size, struct hand_reply *reply)
{
    uint16_t code;
    size_t i;
    if (size < 5 || size > 256) {
        return false;
    }
    code = hand_crc(data, size - 2);
    if (data[size - 2] != (code & 0xFF) || data[size - 1] != code >> 8) {
        return false;
    }
    reply->station = data[0];
    reply->function = data[1];
    reply->count = 0;
    if (data[1] == 0x83) {
        reply->code = data[2];
        return size == 5;
    }
    if (data[1] != 3 || data[2] % 2 != 0 || (size_t)data[2] + 5 != size || data[2] > 250) {
        return false;
    }
    reply->count = data[2] / 2;
    for (i = 0; i < reply->count; i++) {
        reply->values[i] = (uint16_t)(data[3 + 2 * i] << 8 | data[4 + 2 * i]);
    }
    return true;
}

size_t hand_encode(const struct hand_reply *reply, uint8_t *to, size_t room)
{
    size_t size = reply->function == 3 ? 3 + 2 * (size_t)reply->count : 3, i;
    uint16_t code;
    if (room < size + 2 || reply->count > 125) {
        return 0;
    }
    to[0] = reply->station;
    to[1] = reply->function;
    if (reply->function == 3) {
        to[2] = (uint8_t)(2 * reply->count);
        for (i = 0; i < reply->count; i++) {
            to[3 + 2 * i] = (uint8_t)(reply->values[i] >> 8);
            to[4 + 2 * i] = (uint8_t)reply->values[i];
        }
    } else {
        to[2] = reply->code;
    }
    code = hand_crc(to, size);
    to[size] = (uint8_t)code;
    to[size + 1] = (uint8_t)(code >> 8);
    return size + 2;
}

static void drop(struct hand_parser *parser, size_t count)
{
    memmove(parser->buffer, parser->buffer + count, parser->size - count);
    parser->size -= count;
}

size_t hand_put(struct hand_parser *parser, const uint8_t *data, size_t size)
{
    size_t room = sizeof parser->buffer - parser->size;
    size = size < room ? size : room;
    memcpy(parser->buffer + parser->size, data, size);
    parser->size += size;
    return size;
}

bool hand_next(struct hand_parser *parser, struct hand_reply *reply)
{
    if (parser->told > 0) {
        drop(parser, parser->told);
        parser->told = 0;
    }
    while (parser->size > 1) {
        const uint8_t *data = parser->buffer;
        size_t size = 0;
        if (data[1] == 0x83) {
            size = 5;
        } else if (data[1] == 3) {
            if (parser->size < 3) {
                return false;
            }
            size = data[2] <= 250 && data[2] % 2 == 0 ? (size_t)data[2] + 5 : 0;
        }
        if (size > parser->size) {
            return false;
        }
        if (size > 0 && hand_decode(data, size, reply)) {
            parser->told = size;
            return true;
        }
        parser->noise++;
        drop(parser, 1);
    }
    return false;
}
