/* The register reply of Modbus RTU as one writes it by hand: a struct, and functions for this frame only. */
#ifndef BY_HAND_H
#define BY_HAND_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct hand_reply {
    uint8_t station, function, code; /* code: of an exception */
    uint8_t count;
    uint16_t values[125];
};

struct hand_parser {
    uint8_t buffer[256];
    size_t size, told, noise;
};

uint16_t hand_crc(const uint8_t *data, size_t size);
/* Both give false for what is no such reply. */
bool hand_decode(const uint8_t *data, size_t size, struct hand_reply *reply);
size_t hand_encode(const struct hand_reply *reply, uint8_t *to, size_t room);
/* Bytes in, replies out: as many bytes as there is room for; true for each reply that was found. */
size_t hand_put(struct hand_parser *parser, const uint8_t *data, size_t size);
bool hand_next(struct hand_parser *parser, struct hand_reply *reply);

#ifdef __cplusplus
}
#endif
#endif
